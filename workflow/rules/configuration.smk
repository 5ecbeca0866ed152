# What is configured, refused in one line where it is wrong, before any rule is read.
from pathlib import Path

from eitskin.capture.attached import attach
from eitskin.configuration import read, validate, with_continuous
from eitskin.errors import reported
from eitskin.fingerprint import fingerprint

# Snakemake's own reading says neither line nor column, and runs what a template holds.
with reported("logs/configuration.log"):
    if Path("config.yaml").exists():
        read("config.yaml")


configfile: "config.yaml"


with reported("logs/configuration.log"):
    *overrides, default = workflow.configfiles
    CONFIGFILES = [default, *overrides]
    schema = workflow.source_path("../schemas/config.schema.yaml")
    validate(config, schema, CONFIGFILES)
    if "rig" in config:
        attach(config, CONFIGFILES)
    config["configurations"] = with_continuous(config)


NO_NAME = "(?!)"


wildcard_constraints:
    configuration="|".join(config["configurations"]),
    recording="|".join(config["recordings"]),

# What is configured, refused in one line where it is wrong, before any rule is read.
from pathlib import Path

from snakemake.exceptions import WorkflowError
from snakemake.utils import update_config

try:
    from eitskin.errors import reported
except ModuleNotFoundError:
    raise WorkflowError(
        "eitskin is not in Snakemake's Python: pip install CLONE[workflow]"
    ) from None

# Whoever adds an effect or a format may leave it broken: read with them, it is told in one line.
with reported("logs/configuration.log"):
    from eitskin.capture.attachment import attach
    from eitskin.configuration import (
        COMMAND_LINE,
        any_of,
        canonical,
        read,
        validate,
        with_continuous,
    )
    from eitskin import provenance
    from eitskin.fingerprint import fingerprint, fingerprinted, keep, recall

recall(provenance.PARSED)
ROOT = Path(workflow.current_basedir.get_path_or_uri(secret_free=False)).resolve().parents[1]


def own(file):
    """A file of this workflow: by its path within it where that is run, else, as of a module of
    another workflow, by its whole path."""
    return file if ROOT == Path.cwd().resolve() else str(ROOT / file)


# Another workflow's configuration files are no business of a module.
AS_MODULE = workflow.modifier.skip_configfile
REST = "config of the module" if AS_MODULE else COMMAND_LINE
# Snakemake's own reading says neither line nor column, and runs what a template holds.
with reported("logs/configuration.log"):
    if Path("config.yaml").exists() and not AS_MODULE:
        read("config.yaml")


configfile: "config.yaml" if Path("config.yaml").exists() else own("config.yaml")


with reported("logs/configuration.log"):
    DEFAULTS = own("config.yaml")
    FILES = [] if AS_MODULE else [str(file) for file in workflow.configfiles]
    *overrides, default = FILES or [DEFAULTS]
    CONFIGFILES = list(dict.fromkeys([DEFAULTS, default, *overrides]))
    if DEFAULTS not in FILES:
        given, config = config, read(DEFAULTS)
        update_config(config, given)
    schema = workflow.source_path("../schemas/config.schema.yaml")
    validate(config, schema, CONFIGFILES, REST)
    if "rig" in config:
        attach(config, CONFIGFILES, REST)
    config.update(canonical(config, schema))
    config["configurations"] = with_continuous(config)


OTHERS = {rule.name for rule in workflow.rules}  # of the workflow that this one is a module of
# Where results lie in a storage Snakemake's own records tell what is to run, else recipes do.
IN_STORAGE = workflow.storage_settings.default_storage_provider is not None

if not IN_STORAGE:

    inputflags:
        ancient,


# All of them, before any rule: a second statement undoes those of rules before it where results lie
# in a storage (Snakemake 9.27).
wildcard_constraints:
    configuration=any_of(config["configurations"]),
    recording=any_of(config["recordings"]),
    model=r"(?!(?:autoencoder|regressor)[./])[a-z-]+",  # the teachers stand beside the models
    budget=any_of(config["budgets"]),
    seed=r"\d+",

from calibration.blocks import batches
from concealed.naming import batches as case_batches
from concealed.naming import names as case_names
from eitskin import ablation
from eitskin.capture.attached import attach, manifest_path
from eitskin.simulate.chain import instrument_effects, last_link, link_before, skin_effects
from eitskin.configuration import captured_path, file_of, validate, with_continuous
from eitskin.errors import reported
from eitskin.fingerprint import fingerprint
from eitskin.paper.rows import rows
from loop.naming import DIAGNOSIS, LABELS, SOURCES, TRUTH, named
from snakemake.utils import min_version

min_version("9.0")


configfile: "config.yaml"


with reported("logs/configuration.log"):
    schema = workflow.source_path("workflow/schemas/config.schema.yaml")
    *overrides, default = workflow.configfiles
    validate(config, schema, [default, *overrides])
    if "rig" in config:
        attach(config, [default, *overrides])
    config["configurations"] = with_continuous(config)


NO_NAME = "(?!)"


wildcard_constraints:
    configuration="|".join(config["configurations"]),
    recording="|".join(config["recordings"]),


include: "workflow/rules/simulate.smk"
include: "workflow/rules/perturb.smk"
include: "workflow/rules/record.smk"


if "rig" in config:

    include: "workflow/rules/capture.smk"


include: "workflow/rules/compare.smk"
include: "workflow/rules/diagnose.smk"
include: "workflow/rules/diagnosis_report.smk"
include: "workflow/rules/dataset.smk"
include: "workflow/rules/train.smk"
include: "workflow/rules/evaluate.smk"
include: "workflow/rules/ablation_plan.smk"
include: "workflow/rules/ablation.smk"
include: "workflow/rules/figures.smk"
include: "workflow/rules/limit.smk"
include: "workflow/rules/transfer.smk"
include: "workflow/rules/calibrate.smk"
include: "workflow/rules/concealed_plan.smk"
include: "workflow/rules/concealed.smk"
include: "workflow/rules/concealed_score.smk"
include: "workflow/rules/held_out.smk"
include: "workflow/rules/loop.smk"
include: "workflow/rules/paper.smk"


rule all:
    default_target: True
    input:
        "results/simulated/clean.parquet",
        "results/tables/table_1.csv",
        [
            f"results/limit/simulated-{name}-continuous.cramer_rao.csv"
            for name, splits in config["table_1"]["configurations"].items()
            if "continuous" in splits
        ],
        expand("results/recordings/{recording}.check.txt", recording=config["recordings"]),
        expand("results/diagnosis/{recording}/report.html", recording=config["diagnoses"]),
        "results/concealed/demo/score/score.md",
        rules.concealed_case.output,

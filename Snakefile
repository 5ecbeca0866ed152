from snakemake.utils import min_version

min_version("9.0")


report: "workflow/report/workflow.rst"


include: "workflow/rules/configuration.smk"
include: "workflow/rules/in_use.smk"
include: "workflow/rules/simulate.smk"
include: "workflow/rules/perturb.smk"
include: "workflow/rules/record.smk"
include: "workflow/rules/capture.smk"
include: "workflow/rules/diagnose.smk"
include: "workflow/rules/real.smk"
include: "workflow/rules/dataset.smk"
include: "workflow/rules/train.smk"
include: "workflow/rules/limit.smk"
include: "workflow/rules/evaluate.smk"
include: "workflow/rules/ablation.smk"
include: "workflow/rules/transfer.smk"
include: "workflow/rules/figures.smk"
include: "workflow/rules/paper.smk"
include: "workflow/rules/calibrate.smk"
include: "workflow/rules/concealed.smk"
include: "workflow/rules/loop.smk"


rule all:
    """Table I, limits, checks, diagnoses and the demonstration of concealed cases."""
    default_target: True
    input:
        rules.clean.output,
        rules.table_1.output,
        expand(
            "results/limit/simulated-{set}.{table}.csv",
            set=CONTINUOUS_SETS,
            table=["ratios", "cramer_rao"],
        ),
        expand("results/recordings/{recording}.check.txt", recording=config["recordings"]),
        expand("results/diagnosis/{recording}/report.html", recording=config["diagnoses"]),
        rules.concealed_demo.input,


include: "workflow/rules/provenance.smk"

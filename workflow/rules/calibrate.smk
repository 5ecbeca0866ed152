from proof.blocks import FIRST_SEED, batches, sort_of, tables


# No fingerprint: hours of work are made anew on request alone, `--forcerun trials`; the summary says
# how many rows are of other code.
rule trials:
    """Diagnoses of recordings whose truth is known, a batch."""
    output:
        "results/calibration/{block}/batches/{size}-{batch}.csv",
    log:
        "logs/trials/{block}/{size}-{batch}.log",
    benchmark:
        "logs/benchmarks/trials/{block}/{size}-{batch}.tsv"
    wildcard_constraints:
        block=any_of(FIRST_SEED),
        size="quick|full",
        batch=r"\d+",
    conda:
        "../../envs/proof.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards: 4000 if sort_of(wildcards.block) == "owners" else 2000,
        runtime=60,
    params:
        trials=lambda wildcards: batches(wildcards.block, wildcards.size)[int(wildcards.batch)],
    message:
        "Diagnosing recordings whose truth is known: {wildcards.block}, batch {wildcards.batch}"
    script:
        "../scripts/trials.py"


rule score_trials:
    """Score of the diagnosis on a block of trials."""
    input:
        expand(
            "results/calibration/{block}/batches/{size}-{batch}.csv",
            **config["calibration"],
            batch=range(len(batches(**config["calibration"]))),
        ),
    output:
        expand(
            "results/calibration/{block}/{file}",
            block=config["calibration"]["block"],
            file=[
                "summary.md",
                *(f"{name}.csv" for name in tables(config["calibration"]["block"])),
            ],
        ),
    log:
        "logs/score_trials.log",
    benchmark:
        "logs/benchmarks/score_trials.tsv"
    conda:
        "../../envs/proof.yaml"
    threads: 1
    resources:
        mem_mb=1000,
        runtime=5,
    params:
        block=config["calibration"]["block"],
        size=config["calibration"]["size"],
        code=fingerprint("score_trials", CATALOGUE),
    message:
        "Scoring the diagnosis: block {params.block}, {params.size}"
    script:
        "../scripts/score_trials.py"


CALIBRATION_FIGURES = {
    "confusion": "left out and called",
    "other_calibration": "probability of something else",
}


rule calibration_figures:
    """Figures of the diagnosis's calibration."""
    input:
        tables=expand(
            "results/calibration/{block}/{file}.csv",
            block=config["calibration"]["block"],
            file=["confusion", "other_calibration"],
        ),
    output:
        [
            report(
                f"results/calibration/{config['calibration']['block']}/{name}.svg",
                caption=f"../report/{name}.rst",
                category="4 Calibration of the diagnosis",
                labels={"shows": shows},
            )
            for name, shows in CALIBRATION_FIGURES.items()
        ],
        images=expand(
            "results/calibration/{block}/{name}.png",
            block=config["calibration"]["block"],
            name=CALIBRATION_FIGURES,
        ),
    log:
        "logs/calibration_figures.log",
    benchmark:
        "logs/benchmarks/calibration_figures.tsv"
    conda:
        "../../envs/proof.yaml"
    threads: 1
    resources:
        mem_mb=500,
        runtime=5,
    params:
        code=fingerprint("block_figures"),
    message:
        "Drawing the calibration of the diagnosis"
    script:
        "../scripts/block_figures.py"


rule calibrate_diagnosis:
    """Trials of a block, their score and figures: hours."""
    input:
        rules.score_trials.output,
        rules.calibration_figures.output
        if sort_of(config["calibration"]["block"]) == "diagnoses"
        else [],

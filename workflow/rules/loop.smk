from loop.naming import DIAGNOSIS, LABELS, SOURCES, TRUTH, cases_by_name

FORCES = {key: config["forces"][key] for key in ("mean_N", "sd_N", "max_N")}
LOOP = "results/loop/{case}"
LOOP_CASES = cases_by_name(config["loop"]["cases"])
LOOP_SKINS = config["loop"]["recordings"]
# The paper's perturbations are no names of a diagnosis.
CATALOGUE_AND_AUTHORS = sorted({*CATALOGUE, *modules(names_of(effects_of("authors")))})


rule loop_case:
    """Recording of a skin whose owner does not know all."""
    output:
        recording=f"{LOOP}/recording.parquet",
        target=f"{LOOP}/target.parquet",
        split=f"{LOOP}/split.parquet",
        truth=f"{LOOP}/truth.json",
    log:
        "logs/loop_case/{case}.log",
    benchmark:
        "logs/benchmarks/loop_case/{case}.tsv"
    wildcard_constraints:
        case=any_of(LOOP_CASES),
    conda:
        "../../envs/learning.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=30,
    params:
        drawn=lambda wildcards: LOOP_CASES[wildcards.case],
        size={key: config["loop"][key] for key in ("frames", "tested", "share")},
        forces=FORCES,
        probe_mm=lookup(dpath="touch_grid/probe_mm", within=config),
        code=fingerprint("loop_case"),
    message:
        "Drawing the skin {wildcards.case}, whose owner does not know all"
    script:
        "../scripts/loop_case.py"


rule loop_labelled:
    """Recording with 5 % of a case's labels."""
    input:
        recording="results/recordings/{case}.parquet",
        target="results/datasets/{case}.parquet",
    output:
        recording=f"{LOOP}/recording.parquet",
        target=f"{LOOP}/target.parquet",
        split=f"{LOOP}/split.parquet",
    log:
        "logs/loop_labelled/{case}.log",
    benchmark:
        "logs/benchmarks/loop_labelled/{case}.tsv"
    wildcard_constraints:
        case=any_of(LOOP_SKINS),
    conda:
        "../../envs/learning.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=10,
    params:
        seed=lookup(dpath="seed", within=config),
        code=fingerprint("loop_labelled"),
    message:
        "Keeping 5 % of the labels of {wildcards.case}"
    script:
        "../scripts/loop_labelled.py"


use rule diagnose as diagnose_loop with:
    input:
        schema=ancient(local(SCHEMA)),
        recording=f"{LOOP}/recording.parquet",
    output:
        diagnosis=f"{LOOP}/diagnosis/diagnosis.json",
        effects=f"{LOOP}/diagnosis/effects.yaml",
        evidence=expand(f"{LOOP}/diagnosis/evidence/{{file}}", file=EVIDENCE, allow_missing=True),
    log:
        "logs/diagnose_loop/{case}.log",
    benchmark:
        "logs/benchmarks/diagnose_loop/{case}.tsv"
    wildcard_constraints:
        case=any_of([*LOOP_CASES, *LOOP_SKINS]),
    params:
        name="{case}",
        seed=lookup(dpath="seed", within=config),
        code=fingerprint("diagnose", CATALOGUE, [SCHEMA]),
    message:
        "Diagnosing {wildcards.case} from its labelled frames"


rule loop_errors:
    """Test errors of a model trained on one source for a case."""
    input:
        recording=f"{LOOP}/recording.parquet",
        target=f"{LOOP}/target.parquet",
        split=f"{LOOP}/split.parquet",
        told=lambda wildcards: {
            TRUTH: [f"{LOOP}/truth.json"],
            DIAGNOSIS: [rules.diagnose_loop.output.diagnosis, rules.diagnose_loop.output.effects],
        }.get(wildcards.source, []),
    output:
        f"{LOOP}/errors/{{model}}/{{source}}/{{seed}}.csv",
    log:
        "logs/loop_errors/{case}/{model}/{source}/{seed}.log",
    benchmark:
        "logs/benchmarks/loop_errors/{case}/{model}/{source}/{seed}.tsv"
    wildcard_constraints:
        source=any_of([*SOURCES, LABELS]),
    conda:
        "../../envs/learning.yaml"
    threads: 1
    resources:
        mem_mb=3000,
        runtime=120,
    params:
        latent_dim=lookup(dpath="training/latent_dim", within=config),
        recipe=recipe_of_row,
        budget=lambda wildcards: spent(config["loop"]["budget"], wildcards.model),
        seed=lambda wildcards: int(wildcards.seed),
        draw=lambda wildcards: int(wildcards.seed) - config["seed"],
        authors=lookup(dpath="configurations/authors/effects", within=config),
        forces=FORCES,
        probe_mm=lookup(dpath="touch_grid/probe_mm", within=config),
        code=lambda wildcards: fingerprint(
            "loop_errors", [*CATALOGUE_AND_AUTHORS, *models.modules(wildcards.model)]
        ),
    message:
        "Training {wildcards.model} for {wildcards.case} on its {wildcards.source}, seed {wildcards.seed}"
    script:
        "../scripts/loop_errors.py"


# The truth of a real skin is not known.
LOOP_RUNS = [
    {"case": case, "model": model, "source": source, "seed": config["seed"] + number}
    for case in [*LOOP_CASES, *LOOP_SKINS]
    for model in config["loop"]["models"]
    for source in [*SOURCES, LABELS]
    for number in range(config["loop"]["budget"]["seeds"])
    if source != TRUTH or case in LOOP_CASES
]


rule loop_table:
    """Table of what a diagnosis is worth to an estimator."""
    input:
        errors=[
            f"{LOOP}/errors/{{model}}/{{source}}/{{seed}}.csv".format(**run) for run in LOOP_RUNS
        ],
        diagnoses=expand(f"{LOOP}/diagnosis/diagnosis.json", case=[*LOOP_CASES, *LOOP_SKINS]),
        truths=expand(f"{LOOP}/truth.json", case=LOOP_CASES),
    output:
        csv=report(
            "results/loop/loop.csv",
            caption="../report/loop.rst",
            category="5 The loop closed",
            labels={"shows": "errors by what a model learned from, CSV"},
        ),
        markdown=report(
            "results/loop/loop.md",
            caption="../report/loop.rst",
            category="5 The loop closed",
            labels={"shows": "errors and what was named, text"},
        ),
    log:
        "logs/loop_table.log",
    benchmark:
        "logs/benchmarks/loop_table.tsv"
    localrule: True
    conda:
        "../../envs/learning.yaml"
    threads: 1
    resources:
        mem_mb=1000,
        runtime=5,
    params:
        runs=[{key: run[key] for key in ("case", "model", "source")} for run in LOOP_RUNS],
        code=fingerprint("loop_table"),
    message:
        "Collecting what a diagnosis is worth to an estimator"
    script:
        "../scripts/loop_table.py"


rule loop_figure:
    """Figure of what a diagnosis is worth to a model."""
    input:
        rules.loop_table.output.csv,
    output:
        svg=report(
            "results/loop/{model}.svg",
            caption="../report/loop.rst",
            category="5 The loop closed",
            labels={"shows": "{model}"},
        ),
        png="results/loop/{model}.png",
        csv="results/loop/{model}.csv",
    log:
        "logs/loop_figure/{model}.log",
    benchmark:
        "logs/benchmarks/loop_figure/{model}.tsv"
    wildcard_constraints:
        model=any_of(config["loop"]["models"]),
    conda:
        "../../envs/learning.yaml"
    threads: 1
    resources:
        mem_mb=1000,
        runtime=5,
    params:
        code=fingerprint("loop_figure"),
    message:
        "Drawing what a diagnosis is worth to {wildcards.model}"
    script:
        "../scripts/loop_figure.py"


rule loop:
    """Table and figures of what a diagnosis is worth."""
    input:
        rules.loop_table.output,
        expand(
            "results/loop/{model}.{kind}",
            model=config["loop"]["models"],
            kind=["svg", "png", "csv"],
        ),

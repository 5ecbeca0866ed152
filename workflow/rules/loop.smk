FORCES = {key: config["forces"][key] for key in ("mean_N", "sd_N", "max_N")}
LOOP = "results/loop/{case}"
LOOP_CASES = named(config["loop"]["cases"])
LOOP_SKINS = config["loop"]["recordings"]


rule loop_case:
    output:
        recording=f"{LOOP}/recording.parquet",
        target=f"{LOOP}/target.parquet",
        split=f"{LOOP}/split.parquet",
        truth=f"{LOOP}/truth.json",
    log:
        "logs/loop_case/{case}.log",
    benchmark:
        "benchmarks/loop_case/{case}.tsv"
    wildcard_constraints:
        case="|".join(LOOP_CASES) or NO_NAME,
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
        code=fingerprint("eitskin.data.dataset"),
    message:
        "Drawing the skin {wildcards.case}, whose owner does not know all"
    script:
        "../scripts/loop_case.py"


rule loop_labelled:
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
        "benchmarks/loop_labelled/{case}.tsv"
    wildcard_constraints:
        case="|".join(LOOP_SKINS) or NO_NAME,
    conda:
        "../../envs/learning.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=10,
    params:
        seed=lookup(dpath="seed", within=config),
        code=fingerprint("eitskin.learn.transfer"),
    message:
        "Keeping 5 % of the labels of {wildcards.case}"
    script:
        "../scripts/loop_labelled.py"


use rule diagnose as diagnose_loop with:
    input:
        schema="workflow/schemas/diagnosis.schema.yaml",
        recording=f"{LOOP}/recording.parquet",
    output:
        diagnosis=f"{LOOP}/diagnosis/diagnosis.json",
        effects=f"{LOOP}/diagnosis/effects.yaml",
        evidence=expand(f"{LOOP}/diagnosis/evidence/{{file}}", file=EVIDENCE, allow_missing=True),
    log:
        "logs/diagnose_loop/{case}.log",
    benchmark:
        "benchmarks/diagnose_loop/{case}.tsv"
    wildcard_constraints:
        case="|".join([*LOOP_CASES, *LOOP_SKINS]) or NO_NAME,
    params:
        name="{case}",
        seed=lookup(dpath="seed", within=config),
        code=fingerprint("eitskin.diagnose.diagnosis"),
    message:
        "Diagnosing {wildcards.case} from its labelled frames"


rule loop_errors:
    input:
        recording=f"{LOOP}/recording.parquet",
        target=f"{LOOP}/target.parquet",
        split=f"{LOOP}/split.parquet",
        told=lambda wildcards: {
            TRUTH: [f"{LOOP}/truth.json"],
            DIAGNOSIS: [rules.diagnose_loop.output.diagnosis, rules.diagnose_loop.output.effects],
        }.get(wildcards.source, []),
    output:
        f"{LOOP}/errors/{{model}}/{{source}}.csv",
    log:
        "logs/loop_errors/{case}/{model}/{source}.log",
    benchmark:
        "benchmarks/loop_errors/{case}/{model}/{source}.tsv"
    wildcard_constraints:
        source="|".join([*SOURCES, LABELS]),
    conda:
        "../../envs/learning.yaml"
    threads: 1
    resources:
        mem_mb=3000,
        runtime=120,
    params:
        learning_rate=lookup(dpath="training/learning_rate", within=config),
        weight_decay=lookup(dpath="training/weight_decay", within=config),
        batch_size=lookup(dpath="training/batch_size", within=config),
        latent_dim=lookup(dpath="training/latent_dim", within=config),
        force_weight=lookup(dpath="training/force_weight", within=config),
        lambda_latent=rules.train_predictor.params.lambda_latent,
        budget=lookup(dpath="loop/budget", within=config),
        seed=lookup(dpath="seed", within=config),
        authors=lookup(dpath="configurations/authors/effects", within=config),
        forces=FORCES,
        probe_mm=lookup(dpath="touch_grid/probe_mm", within=config),
        code=[fingerprint("eitskin.learn.transfer"), fingerprint("eitskin.diagnose.diagnosis")],
    message:
        "Training {wildcards.model} for {wildcards.case} on its {wildcards.source}"
    script:
        "../scripts/loop_errors.py"


# The truth of a real skin is not known.
LOOP_RUNS = [
    {"case": case, "model": model, "source": source}
    for case in [*LOOP_CASES, *LOOP_SKINS]
    for model in config["loop"]["models"]
    for source in [*SOURCES, LABELS]
    if source != TRUTH or case in LOOP_CASES
]


rule loop:
    input:
        errors=[f"{LOOP}/errors/{{model}}/{{source}}.csv".format(**run) for run in LOOP_RUNS],
        diagnoses=expand(rules.diagnose_loop.output.diagnosis, case=[*LOOP_CASES, *LOOP_SKINS]),
        truths=expand(rules.loop_case.output.truth, case=LOOP_CASES),
    output:
        csv=report(
            "results/loop/loop.csv",
            caption="../report/loop.rst",
            category="The loop closed",
            labels={"shows": "errors by what a model learned from, CSV"},
        ),
        markdown=report(
            "results/loop/loop.md",
            caption="../report/loop.rst",
            category="The loop closed",
            labels={"shows": "errors and what was named, text"},
        ),
        figures=[
            report(
                f"results/loop/{model}.{suffix}",
                caption="../report/loop.rst",
                category="The loop closed",
                labels={"shows": f"{model}, {suffix.upper()}"},
            )
            for model in config["loop"]["models"]
            for suffix in ("svg", "png", "csv")
        ],
    log:
        "logs/loop.log",
    benchmark:
        "benchmarks/loop.tsv"
    conda:
        "../../envs/learning.yaml"
    threads: 1
    resources:
        mem_mb=1000,
        runtime=5,
    params:
        runs=LOOP_RUNS,
        models=config["loop"]["models"],
        code=fingerprint("eitskin.paper.transfer_table"),
    message:
        "Collecting what a diagnosis is worth to an estimator"
    script:
        "../scripts/loop_table.py"

from eitskin.paper.rows import rows

# The limit's prior of places is a disc: sets on an outline have none.
CONTINUOUS_SETS = [
    f"{name}-continuous"
    for name, splits in config["table_1"]["configurations"].items()
    if "continuous" in splits and "outline" not in config["skin"]
]


rule limit:
    """Errors of touches estimated as well as physics allows."""
    input:
        dataset="results/datasets/simulated-{configuration}.parquet",
        split="results/splits/simulated-{configuration}/continuous.parquet",
    output:
        metrics="results/limit/simulated-{configuration}.csv",
        samples="results/limit/simulated-{configuration}.samples.csv",
    log:
        "logs/limit/{configuration}.log",
    benchmark:
        "logs/benchmarks/limit/{configuration}.tsv"
    wildcard_constraints:
        configuration="[a-z0-9-]+-continuous",
    conda:
        "../../envs/simulation.yaml"
    threads: 1
    resources:
        mem_mb=1000,
        runtime=60,
    params:
        seed=lookup(dpath="seed", within=config),
        skin=lookup(dpath="skin", within=config),
        accuracy=lookup(dpath="accuracy", within=config),
        effects=of_configuration("effects"),
        session_frames=of_configuration("session_frames"),
        continuous=of_configuration("continuous"),
        samples=lookup(dpath="limit/samples", within=config),
        pairs=lookup(dpath="limit/pairs", within=config),
        code=lambda wildcards: fingerprint(
            "limit", modules(names_of(effects_of(wildcards.configuration)))
        ),
    message:
        "Estimating touches of {wildcards.configuration} as well as physics allows"
    script:
        "../scripts/limit.py"


rule ratios:
    """Errors of models over what physics allows."""
    input:
        samples=rules.limit.output.samples,
        predictions=lambda wildcards: [
            f"results/predictions/{dataset}/{split}/{config['budget']}/{model}.parquet"
            for dataset, split, model in rows(config)
            if dataset == f"simulated-{wildcards.configuration}"
        ],
    output:
        report(
            "results/limit/simulated-{configuration}.ratios.csv",
            caption="../report/ratios.rst",
            category="1 Paper",
            labels={"shows": "what models lack of the limit, {configuration}"},
        ),
    log:
        "logs/ratios/{configuration}.log",
    benchmark:
        "logs/benchmarks/ratios/{configuration}.tsv"
    wildcard_constraints:
        configuration=any_of(CONTINUOUS_SETS),
    localrule: True
    conda:
        "../../envs/learning.yaml"
    threads: 1
    resources:
        mem_mb=500,
        runtime=5,
    params:
        seed=lookup(dpath="seed", within=config),
        code=fingerprint("ratios"),
    message:
        "Holding the models of {wildcards.configuration} against what physics allows"
    script:
        "../scripts/ratios.py"


rule cramer_rao:
    """Cramér-Rao bounds over the skin."""
    input:
        dataset="results/datasets/simulated-{configuration}.parquet",
        touch_grid=rules.mesh.output.touch_grid,
    output:
        "results/limit/simulated-{configuration}.cramer_rao.csv",
    log:
        "logs/cramer_rao/{configuration}.log",
    benchmark:
        "logs/benchmarks/cramer_rao/{configuration}.tsv"
    wildcard_constraints:
        configuration="[a-z0-9-]+-continuous",
    group:
        "data"
    conda:
        "../../envs/simulation.yaml"
    threads: 1
    resources:
        mem_mb=1000,
        runtime=20,
    params:
        skin=lookup(dpath="skin", within=config),
        accuracy=lookup(dpath="accuracy", within=config),
        effects=of_configuration("effects"),
        session_frames=of_configuration("session_frames"),
        continuous=of_configuration("continuous"),
        code=lambda wildcards: fingerprint(
            "cramer_rao", modules(names_of(effects_of(wildcards.configuration)))
        ),
    message:
        "Bounding the errors of {wildcards.configuration} over the skin"
    script:
        "../scripts/cramer_rao.py"

from eitskin.paper.rows import repeated, rows

PRINTED_1 = own("workflow/eitskin/paper/printed_table_1.csv")


rule evaluate:
    """Test errors of a model, all seeds and their mean."""
    input:
        dataset="results/datasets/{dataset}.parquet",
        split="results/splits/{dataset}/{split}.parquet",
        models=of_all_seeds(f"{MODELS}/{{model}}/{{seed}}.pt"),
    output:
        predictions="results/predictions/{dataset}/{split}/{budget}/{model}.parquet",
        metrics="results/metrics/{dataset}/{split}/{budget}/{model}.csv",
    log:
        "logs/evaluate/{dataset}/{split}/{budget}/{model}.log",
    benchmark:
        "logs/benchmarks/evaluate/{dataset}/{split}/{budget}/{model}.tsv"
    group:
        "evaluation"
    conda:
        "../../envs/learning.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=10,
    params:
        code=of_model("evaluate"),
    message:
        "Testing {wildcards.model} on {wildcards.dataset}, {wildcards.split}"
    script:
        "../scripts/evaluate.py"


rule predict:
    """Estimates of a model for another recording."""
    input:
        models=of_all_seeds(f"{MODELS}/{{model}}/{{seed}}.pt"),
        recording="results/recordings/{recording}.parquet",
    output:
        "results/predictions/{dataset}/{split}/{budget}/{model}/{recording}.parquet",
    log:
        "logs/predict/{dataset}/{split}/{budget}/{model}/{recording}.log",
    benchmark:
        "logs/benchmarks/predict/{dataset}/{split}/{budget}/{model}/{recording}.tsv"
    conda:
        "../../envs/learning.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=10,
    params:
        code=of_model("predict"),
    message:
        "Applying {wildcards.model}, trained on {wildcards.dataset}, to {wildcards.recording}"
    script:
        "../scripts/predict.py"


rule export:
    """Model as one file that needs no torch, for `eitskin stream`."""
    input:
        dataset="results/datasets/{dataset}.parquet",
        split="results/splits/{dataset}/{split}.parquet",
        models=of_all_seeds(f"{MODELS}/{{model}}/{{seed}}.pt"),
        recording=branch(
            lambda wildcards: wildcards.dataset in config["recordings"],
            then="results/recordings/{dataset}.parquet",
        ),
    output:
        "results/exported/{dataset}/{split}/{budget}/{model}.npz",
    log:
        "logs/export/{dataset}/{split}/{budget}/{model}.log",
    benchmark:
        "logs/benchmarks/export/{dataset}/{split}/{budget}/{model}.tsv"
    conda:
        "../../envs/learning.yaml"
    threads: 1
    resources:
        mem_mb=3000,
        runtime=60,
    params:
        skin=lookup(dpath="skin", within=config),
        epochs=lambda wildcards: spent(config["budgets"][wildcards.budget])["epochs"],
        code=of_model("export"),
    message:
        "Exporting {wildcards.model} of {wildcards.dataset}, {wildcards.split}"
    script:
        "../scripts/export.py"


rule table_1:
    """Table I of the paper."""
    input:
        paper=ancient(local(PRINTED_1)),
        metrics=[
            f"results/metrics/{dataset}/{split}/{config['budget']}/{model}.csv"
            for dataset, split, model in rows(config)
        ],
        limits=expand("results/limit/simulated-{set}.csv", set=CONTINUOUS_SETS),
    output:
        csv=report(
            "results/tables/table_1.csv",
            caption="../report/table_1.rst",
            category="1 Paper",
            labels={"shows": "Table I, CSV"},
        ),
        markdown=report(
            "results/tables/table_1.md",
            caption="../report/table_1.rst",
            category="1 Paper",
            labels={"shows": "Table I, for reading"},
        ),
    log:
        "logs/table_1.log",
    benchmark:
        "logs/benchmarks/table_1.tsv"
    localrule: True
    conda:
        "../../envs/learning.yaml"
    threads: 1
    resources:
        mem_mb=500,
        runtime=5,
    params:
        repeated=repeated(config),
        code=fingerprint("table_1", [], files=[PRINTED_1]),
    message:
        "Collecting Table I"
    script:
        "../scripts/table_1.py"

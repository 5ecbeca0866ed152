TRANSFER = "results/transfer/{budget}/{model}"


rule transfer_source:
    """Errors on a recording of a model trained on a simulation."""
    input:
        source="results/datasets/{source}.parquet",
        source_split="results/splits/{source}/random.parquet",
        models=of_all_seeds("results/models/{source}/random/{budget}/{model}/{seed}.pt"),
        target="results/datasets/{recording}.parquet",
        split="results/splits/{recording}/place.parquet",
        recording=rules.import_recording.output[0],
    output:
        f"{TRANSFER}/{{source}}/{{recording}}.csv",
    log:
        "logs/transfer_source/{budget}/{model}/{source}/{recording}.log",
    benchmark:
        "logs/benchmarks/transfer_source/{budget}/{model}/{source}/{recording}.tsv"
    wildcard_constraints:
        source=f"simulated-(?:{any_of(config['configurations'])})",
    conda:
        "../../envs/learning.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=30,
    params:
        seed=lookup(dpath="seed", within=config),
        code=of_model("transfer_source"),
    message:
        "Transferring {wildcards.model} from {wildcards.source} to {wildcards.recording}"
    script:
        "../scripts/transfer_source.py"


rule transfer_references:
    """Errors of a model trained on 5 % of a recording's labels."""
    input:
        dataset="results/datasets/{recording}.parquet",
        split="results/splits/{recording}/place.parquet",
        models=of_all_seeds("results/models/{recording}/place/{budget}/{model}/{seed}.pt"),
    output:
        f"{TRANSFER}/references/{{recording}}.csv",
    log:
        "logs/transfer_references/{budget}/{model}/{recording}.log",
    benchmark:
        "logs/benchmarks/transfer_references/{budget}/{model}/{recording}.tsv"
    conda:
        "../../envs/learning.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=60,
    params:
        latent_dim=lookup(dpath="training/latent_dim", within=config),
        recipe=recipe_of_row,
        budget=rules.train_predictor.params.budget,
        seed=lookup(dpath="seed", within=config),
        code=of_model("transfer_references"),
    message:
        "Learning {wildcards.model} from 5 % of the labels of {wildcards.recording} alone"
    script:
        "../scripts/transfer_references.py"


rule transfer:
    """Table of what models of simulations are worth on recordings."""
    input:
        errors=expand(
            f"{TRANSFER}/{{source}}/{{recording}}.csv",
            budget=config["budget"],
            model=config["transfer"]["models"],
            source=[*config["transfer"]["sources"], "references"],
            recording=config["transfer"]["targets"],
        ),
    output:
        csv=report(
            "results/tables/transfer.csv",
            caption="../report/transfer.rst",
            category="6 Transfer",
            labels={"shows": "errors of every method, CSV"},
        ),
        markdown=report(
            "results/tables/transfer.md",
            caption="../report/transfer.rst",
            category="6 Transfer",
            labels={"shows": "errors and their reading, text"},
        ),
    log:
        "logs/transfer.log",
    benchmark:
        "logs/benchmarks/transfer.tsv"
    localrule: True
    conda:
        "../../envs/learning.yaml"
    threads: 1
    resources:
        mem_mb=1000,
        runtime=5,
    params:
        code=fingerprint("transfer"),
    message:
        "Collecting what models of simulations are worth on recordings"
    script:
        "../scripts/transfer.py"

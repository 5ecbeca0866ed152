include: "training_plan.smk"


rule train_autoencoder:
    """Autoencoder: the manifold of the voltages."""
    input:
        dataset="results/datasets/{dataset}.parquet",
        split="results/splits/{dataset}/{split}.parquet",
    output:
        f"{MODELS}/autoencoder/{{seed}}.pt",
    log:
        "logs/train_autoencoder/{dataset}/{split}/{budget}/{seed}.log",
    benchmark:
        "logs/benchmarks/train_autoencoder/{dataset}/{split}/{budget}/{seed}.tsv"
    group:
        "training"
    conda:
        "../../envs/learning.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=240,
    params:
        optimiser=optimiser(config["training"]),
        latent_dim=lookup(dpath="training/latent_dim", within=config),
        budget=lambda wildcards: spent(config["budgets"][wildcards.budget]),
        draw=lookup(dpath="seed", within=config),
        seed=lambda wildcards: int(wildcards.seed),
        code=fingerprint("train_autoencoder", [models.TEACHERS["autoencoder"].module]),
    message:
        "Learning the manifold of the voltages of {wildcards.dataset}, {wildcards.split}, seed {wildcards.seed}"
    script:
        "../scripts/train_autoencoder.py"


rule train_regressor:
    """Regressor from a state to latent voltages."""
    input:
        dataset="results/datasets/{dataset}.parquet",
        split="results/splits/{dataset}/{split}.parquet",
        autoencoder=rules.train_autoencoder.output[0],
    output:
        f"{MODELS}/regressor/{{seed}}.pt",
    log:
        "logs/train_regressor/{dataset}/{split}/{budget}/{seed}.log",
    benchmark:
        "logs/benchmarks/train_regressor/{dataset}/{split}/{budget}/{seed}.tsv"
    group:
        "training"
    conda:
        "../../envs/learning.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=240,
    params:
        optimiser=optimiser(config["training"]),
        budget=lambda wildcards: spent(config["budgets"][wildcards.budget]),
        draw=lookup(dpath="seed", within=config),
        seed=lambda wildcards: int(wildcards.seed),
        code=fingerprint("train_regressor", [t.module for t in models.TEACHERS.values()]),
    message:
        "Learning the latent voltages of a state, {wildcards.dataset}, {wildcards.split}, seed {wildcards.seed}"
    script:
        "../scripts/train_regressor.py"


rule train_predictor:
    """Network from voltages to a state, one seed."""
    input:
        dataset="results/datasets/{dataset}.parquet",
        split="results/splits/{dataset}/{split}.parquet",
        teachers=branch(
            informed,
            then=[rules.train_autoencoder.output[0], rules.train_regressor.output[0]],
            otherwise=branch(
                lambda wildcards: models.model(wildcards.model).encoder,
                then=[rules.train_autoencoder.output[0]],
            ),
        ),
    output:
        f"{MODELS}/{{model}}/{{seed}}.pt",
    log:
        "logs/train_predictor/{dataset}/{split}/{budget}/{model}/{seed}.log",
    benchmark:
        "logs/benchmarks/train_predictor/{dataset}/{split}/{budget}/{model}/{seed}.tsv"
    group:
        "training"
    conda:
        "../../envs/learning.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=240,
    params:
        recipe=recipe_of_row,
        budget=lambda wildcards: spent(config["budgets"][wildcards.budget], wildcards.model),
        draw=lookup(dpath="seed", within=config),
        seed=lambda wildcards: int(wildcards.seed),
        code=of_model("train_predictor"),
    message:
        "Training {wildcards.model} on {wildcards.dataset}, {wildcards.split}, seed {wildcards.seed}"
    script:
        "../scripts/train_predictor.py"

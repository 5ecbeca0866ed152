from eitskin.learn.models import with_encoder


wildcard_constraints:
    model=r"(?!(?:autoencoder|regressor)[./])[a-z-]+",  # the teachers stand beside the models
    budget="|".join(config["budgets"]),


rule train_autoencoder:
    input:
        dataset="results/datasets/{dataset}.parquet",
        split="results/splits/{dataset}/{split}.parquet",
    output:
        "results/models/{dataset}/{split}/{budget}/autoencoder.pt",
    log:
        "logs/train_autoencoder/{dataset}/{split}/{budget}.log",
    benchmark:
        "benchmarks/train_autoencoder/{dataset}/{split}/{budget}.tsv"
    conda:
        "../../envs/learning.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=240,
    params:
        learning_rate=lookup(dpath="training/learning_rate", within=config),
        weight_decay=lookup(dpath="training/weight_decay", within=config),
        batch_size=lookup(dpath="training/batch_size", within=config),
        latent_dim=lookup(dpath="training/latent_dim", within=config),
        budget=lookup(dpath="budgets/{budget}", within=config),
        seed=lookup(dpath="seed", within=config),
        code=fingerprint("eitskin.learn.train"),
    message:
        "Learning the manifold of the voltages of {wildcards.dataset}, {wildcards.split}"
    script:
        "../scripts/train_autoencoder.py"


rule train_regressor:
    input:
        dataset="results/datasets/{dataset}.parquet",
        split="results/splits/{dataset}/{split}.parquet",
        autoencoder=rules.train_autoencoder.output[0],
    output:
        "results/models/{dataset}/{split}/{budget}/regressor.pt",
    log:
        "logs/train_regressor/{dataset}/{split}/{budget}.log",
    benchmark:
        "benchmarks/train_regressor/{dataset}/{split}/{budget}.tsv"
    conda:
        "../../envs/learning.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=240,
    params:
        learning_rate=lookup(dpath="training/learning_rate", within=config),
        weight_decay=lookup(dpath="training/weight_decay", within=config),
        batch_size=lookup(dpath="training/batch_size", within=config),
        budget=lookup(dpath="budgets/{budget}", within=config),
        seed=lookup(dpath="seed", within=config),
        code=fingerprint("eitskin.learn.train"),
    message:
        "Learning the latent voltages of a state, {wildcards.dataset}, {wildcards.split}"
    script:
        "../scripts/train_regressor.py"


rule train_predictor:
    input:
        dataset="results/datasets/{dataset}.parquet",
        split="results/splits/{dataset}/{split}.parquet",
        teachers=branch(
            lambda wildcards: wildcards.model.startswith("physics-informed-"),
            then=[rules.train_autoencoder.output[0], rules.train_regressor.output[0]],
            otherwise=branch(
                lambda wildcards: wildcards.model in with_encoder(),
                then=[rules.train_autoencoder.output[0]],
            ),
        ),
    output:
        "results/models/{dataset}/{split}/{budget}/{model}.pt",
    log:
        "logs/train_predictor/{dataset}/{split}/{budget}/{model}.log",
    benchmark:
        "benchmarks/train_predictor/{dataset}/{split}/{budget}/{model}.tsv"
    conda:
        "../../envs/learning.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=240,
    params:
        learning_rate=lookup(dpath="training/learning_rate", within=config),
        weight_decay=lookup(dpath="training/weight_decay", within=config),
        batch_size=lookup(dpath="training/batch_size", within=config),
        force_weight=lookup(dpath="training/force_weight", within=config),
        lambda_latent=lambda wildcards: (
            config["training"]["lambda_latent"]
            if wildcards.model.startswith("physics-informed-")
            else 0.0
        ),
        budget=lookup(dpath="budgets/{budget}", within=config),
        seed=lookup(dpath="seed", within=config),
        code=fingerprint("eitskin.learn.train"),
    message:
        "Training {wildcards.model} on {wildcards.dataset}, {wildcards.split}"
    script:
        "../scripts/train_predictor.py"

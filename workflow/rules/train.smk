from eitskin.learn import models


wildcard_constraints:
    model=r"(?!(?:autoencoder|regressor)[./])[a-z-]+",  # the teachers stand beside the models
    budget="|".join(config["budgets"]),
    seed=r"\d+",


MODELS = "results/models/{dataset}/{split}/{budget}"
OPTIMISER = {
    key: config["training"][key] for key in ("learning_rate", "weight_decay", "batch_size")
}


def spent(budget, **instead):
    """What one seed of a budget costs."""
    return {key: budget[key] for key in ("samples", "epochs", "patience")} | instead


def seeds(model, budget):
    """The seeds that a budget trains; of what is fitted at once, one."""
    return range(config["seed"], config["seed"] + (1 if fitted_at_once(model) else budget["seeds"]))


def of_all_seeds(template):
    """An input function: the files of all seeds of a model."""

    def files(wildcards):
        chosen = seeds(wildcards.model, config["budgets"][wildcards.budget])
        return expand(template, seed=chosen, **wildcards)

    return files


def informed(wildcards):
    return wildcards.model.startswith(models.PHYSICS_INFORMED)


def fitted_at_once(model):
    """Whether a model is support vectors, of which nothing is drawn but the samples."""
    return models.model(model).support_vectors


def by_gradients(value, otherwise):
    """A param; of support vectors, which know neither Adam nor the weight of the force, `otherwise`."""
    return lambda wildcards: otherwise if fitted_at_once(wildcards.model) else value


def of_model(script):
    """A param: the fingerprint of a script that makes or applies the model of its job."""
    return lambda wildcards: fingerprint(script, [models.module(wildcards.model)])


rule train_autoencoder:
    input:
        dataset="results/datasets/{dataset}.parquet",
        split="results/splits/{dataset}/{split}.parquet",
    output:
        f"{MODELS}/autoencoder/{{seed}}.pt",
    log:
        "logs/train_autoencoder/{dataset}/{split}/{budget}/{seed}.log",
    benchmark:
        "benchmarks/train_autoencoder/{dataset}/{split}/{budget}/{seed}.tsv"
    conda:
        "../../envs/learning.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=240,
    params:
        optimiser=OPTIMISER,
        latent_dim=lookup(dpath="training/latent_dim", within=config),
        budget=lambda wildcards: spent(config["budgets"][wildcards.budget]),
        draw=lookup(dpath="seed", within=config),
        seed=lambda wildcards: int(wildcards.seed),
        code=fingerprint("train_autoencoder", []),
    message:
        "Learning the manifold of the voltages of {wildcards.dataset}, {wildcards.split}, seed {wildcards.seed}"
    script:
        "../scripts/train_autoencoder.py"


rule train_regressor:
    input:
        dataset="results/datasets/{dataset}.parquet",
        split="results/splits/{dataset}/{split}.parquet",
        autoencoder=rules.train_autoencoder.output[0],
    output:
        f"{MODELS}/regressor/{{seed}}.pt",
    log:
        "logs/train_regressor/{dataset}/{split}/{budget}/{seed}.log",
    benchmark:
        "benchmarks/train_regressor/{dataset}/{split}/{budget}/{seed}.tsv"
    conda:
        "../../envs/learning.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=240,
    params:
        optimiser=OPTIMISER,
        budget=lambda wildcards: spent(config["budgets"][wildcards.budget]),
        draw=lookup(dpath="seed", within=config),
        seed=lambda wildcards: int(wildcards.seed),
        code=fingerprint("train_regressor", []),
    message:
        "Learning the latent voltages of a state, {wildcards.dataset}, {wildcards.split}, seed {wildcards.seed}"
    script:
        "../scripts/train_regressor.py"


rule train_predictor:
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
        "benchmarks/train_predictor/{dataset}/{split}/{budget}/{model}/{seed}.tsv"
    conda:
        "../../envs/learning.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=240,
    params:
        model="{model}",
        optimiser=by_gradients(OPTIMISER, {}),
        force_weight=by_gradients(config["training"]["force_weight"], 1.0),
        lambda_latent=lambda wildcards: (
            config["training"]["lambda_latent"] if informed(wildcards) else 0.0
        ),
        budget=lambda wildcards: spent(
            config["budgets"][wildcards.budget],
            **({"epochs": None, "patience": None} if fitted_at_once(wildcards.model) else {}),
        ),
        draw=lookup(dpath="seed", within=config),
        seed=lambda wildcards: int(wildcards.seed),
        code=of_model("train_predictor"),
    message:
        "Training {wildcards.model} on {wildcards.dataset}, {wildcards.split}, seed {wildcards.seed}"
    script:
        "../scripts/train_predictor.py"

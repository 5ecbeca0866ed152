use rule train_autoencoder as ablation_autoencoder with:
    output:
        f"{ABLATION}/{{setting}}/autoencoder.pt",
    log:
        "logs/ablation_autoencoder/{dataset}/{split}/{budget}/{setting}.log",
    benchmark:
        "benchmarks/ablation_autoencoder/{dataset}/{split}/{budget}/{setting}.tsv"
    wildcard_constraints:
        setting=any_of(SETTINGS),
    params:
        learning_rate=lookup(dpath="training/learning_rate", within=config),
        weight_decay=lookup(dpath="training/weight_decay", within=config),
        batch_size=lookup(dpath="training/batch_size", within=config),
        latent_dim=lambda wildcards: setting_of(wildcards)["latent_dim"],
        budget=budget_of,
        seed=lookup(dpath="seed", within=config),
        code=fingerprint("eitskin.learn.train"),
    message:
        "Learning the manifold of the voltages of {wildcards.dataset}: {wildcards.setting}"


use rule train_regressor as ablation_regressor with:
    input:
        dataset="results/datasets/{dataset}.parquet",
        split="results/splits/{dataset}/{split}.parquet",
        autoencoder=rules.ablation_autoencoder.output[0],
    output:
        f"{ABLATION}/{{setting}}/regressor.pt",
    log:
        "logs/ablation_regressor/{dataset}/{split}/{budget}/{setting}.log",
    benchmark:
        "benchmarks/ablation_regressor/{dataset}/{split}/{budget}/{setting}.tsv"
    wildcard_constraints:
        setting=any_of(SETTINGS),
    params:
        learning_rate=lookup(dpath="training/learning_rate", within=config),
        weight_decay=lookup(dpath="training/weight_decay", within=config),
        batch_size=lookup(dpath="training/batch_size", within=config),
        budget=budget_of,
        seed=lookup(dpath="seed", within=config),
        code=fingerprint("eitskin.learn.train"),
    message:
        "Learning the latent voltages of a state, {wildcards.dataset}: {wildcards.setting}"


use rule train_predictor as ablation_predictor with:
    input:
        dataset="results/datasets/{dataset}.parquet",
        split="results/splits/{dataset}/{split}.parquet",
        teachers=lambda wildcards: (
            teachers_of(wildcards.setting) if wildcards.model == ablation.INFORMED else []
        ),
    output:
        temp(f"{ABLATION}/{{setting}}/{{model}}.pt"),
    log:
        "logs/ablation_predictor/{dataset}/{split}/{budget}/{setting}/{model}.log",
    benchmark:
        "benchmarks/ablation_predictor/{dataset}/{split}/{budget}/{setting}/{model}.tsv"
    wildcard_constraints:
        setting=f"{any_of(SETTINGS)}|{any_of(GRIDS)}",
    params:
        learning_rate=lambda wildcards: setting_of(wildcards)["learning_rate"],
        weight_decay=lambda wildcards: setting_of(wildcards)["weight_decay"],
        batch_size=lambda wildcards: setting_of(wildcards)["batch_size"],
        force_weight=lambda wildcards: setting_of(wildcards)["force_weight"],
        lambda_latent=lambda wildcards: (
            setting_of(wildcards)["lambda_latent"] if wildcards.model == ablation.INFORMED else 0.0
        ),
        budget=budget_of,
        seed=lookup(dpath="seed", within=config),
        code=fingerprint("eitskin.learn.train"),
    message:
        "Training {wildcards.model} on {wildcards.dataset}, {wildcards.split}: {wildcards.setting}"


rule ablation_tuned:
    input:
        dataset="results/datasets/{dataset}.parquet",
        split="results/splits/{dataset}/{split}.parquet",
        teachers=lambda wildcards: (
            teachers_of("tuned") if wildcards.model == ablation.INFORMED else []
        ),
        scores=lambda wildcards: expand(
            f"{ABLATION}/{{setting}}/{{model}}.csv", setting=GRIDS[wildcards.budget], **wildcards
        ),
    output:
        model=temp(f"{ABLATION}/tuned/{{model}}.pt"),
        chosen=f"{ABLATION}/tuned/{{model}}.txt",
    log:
        "logs/ablation_tuned/{dataset}/{split}/{budget}/{model}.log",
    benchmark:
        "benchmarks/ablation_tuned/{dataset}/{split}/{budget}/{model}.tsv"
    conda:
        "../../envs/learning.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=240,
    params:
        grid=lambda wildcards: GRIDS[wildcards.budget],
        axes=lambda wildcards: list(config["ablation"][wildcards.budget]["grid"]),
        lambda_latent=lambda wildcards: (
            config["training"]["lambda_latent"] if wildcards.model == ablation.INFORMED else 0.0
        ),
        budget=lookup(dpath="budgets/{budget}", within=config),
        seed=lookup(dpath="seed", within=config),
        code=[fingerprint("eitskin.learn.train"), fingerprint("eitskin.paper.ablation")],
    message:
        "Training {wildcards.model} on {wildcards.dataset}, {wildcards.split}, as tuned"
    script:
        "../scripts/ablation_tuned.py"


rule ablation_errors:
    input:
        dataset="results/datasets/{dataset}.parquet",
        split="results/splits/{dataset}/{split}.parquet",
        model=f"{ABLATION}/{{setting}}/{{model}}.pt",
    output:
        f"{ABLATION}/{{setting}}/{{model}}.csv",
    log:
        "logs/ablation_errors/{dataset}/{split}/{budget}/{setting}/{model}.log",
    benchmark:
        "benchmarks/ablation_errors/{dataset}/{split}/{budget}/{setting}/{model}.tsv"
    wildcard_constraints:
        setting=f"{any_of(SETTINGS)}|{any_of(GRIDS)}|tuned",
    conda:
        "../../envs/learning.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=10,
    params:
        part=lambda wildcards: (
            "validation" if wildcards.setting in GRIDS[wildcards.budget] else "test"
        ),
        code=[fingerprint("eitskin.learn.predict"), fingerprint("eitskin.learn.metrics")],
    message:
        "Testing {wildcards.model} on {wildcards.dataset}, {wildcards.split}: {wildcards.setting}"
    script:
        "../scripts/ablation_errors.py"


rule ablation:
    input:
        varied=[
            f"{ABLATION}/{{setting}}/{ablation.INFORMED}.csv".format(
                **study, budget=config["budget"]
            )
            for study in STUDIES
        ],
        plain=[f"{TUNED}/{ablation.PLAIN}.csv".format(**one) for one in COMPARED],
        informed=[f"{TUNED}/{ablation.INFORMED}.csv".format(**one) for one in COMPARED],
        plain_setting=[f"{TUNED}/{ablation.PLAIN}.txt".format(**one) for one in COMPARED],
        informed_setting=[f"{TUNED}/{ablation.INFORMED}.txt".format(**one) for one in COMPARED],
    output:
        varied=report(
            "results/tables/ablation.csv",
            caption="../report/ablation.rst",
            category="Ablation",
            labels={"shows": "each choice varied alone"},
        ),
        compared=report(
            "results/tables/latent_loss.csv",
            caption="../report/ablation.rst",
            category="Ablation",
            labels={"shows": "whether the latent loss helps"},
        ),
        markdown=report(
            "results/tables/ablation.md",
            caption="../report/ablation.rst",
            category="Ablation",
            labels={"shows": "both, for reading"},
        ),
    log:
        "logs/ablation.log",
    benchmark:
        "benchmarks/ablation.tsv"
    conda:
        "../../envs/learning.yaml"
    threads: 1
    resources:
        mem_mb=500,
        runtime=5,
    params:
        varied=STUDIES,
        compared=COMPARED,
        budget=config["budget"],
        code=fingerprint("eitskin.paper.ablation"),
    message:
        "Collecting what the choices in training are worth"
    script:
        "../scripts/ablation.py"

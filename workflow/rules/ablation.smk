include: "ablation_plan.smk"


use rule train_autoencoder as ablation_autoencoder with:
    output:
        f"{ABLATION}/{{setting}}/autoencoder/{{seed}}.pt",
    log:
        "logs/ablation_autoencoder/{dataset}/{split}/{budget}/{setting}/{seed}.log",
    benchmark:
        "logs/benchmarks/ablation_autoencoder/{dataset}/{split}/{budget}/{setting}/{seed}.tsv"
    wildcard_constraints:
        setting=any_of(SETTINGS),
    group:
        "ablation"
    params:
        optimiser=lambda wildcards: optimiser(training_of(wildcards.setting)),
        latent_dim=lambda wildcards: training_of(wildcards.setting)["latent_dim"],
        budget=spent_of,
        draw=lookup(dpath="seed", within=config),
        seed=lambda wildcards: int(wildcards.seed),
        code=fingerprint("train_autoencoder", [models.TEACHERS["autoencoder"].module]),
    message:
        "Learning the manifold of the voltages of {wildcards.dataset}: {wildcards.setting}, seed {wildcards.seed}"


use rule train_regressor as ablation_regressor with:
    input:
        dataset="results/datasets/{dataset}.parquet",
        split="results/splits/{dataset}/{split}.parquet",
        autoencoder=rules.ablation_autoencoder.output[0],
    output:
        f"{ABLATION}/{{setting}}/regressor/{{seed}}.pt",
    log:
        "logs/ablation_regressor/{dataset}/{split}/{budget}/{setting}/{seed}.log",
    benchmark:
        "logs/benchmarks/ablation_regressor/{dataset}/{split}/{budget}/{setting}/{seed}.tsv"
    wildcard_constraints:
        setting=any_of(SETTINGS),
    group:
        "ablation"
    params:
        optimiser=lambda wildcards: optimiser(training_of(wildcards.setting)),
        budget=spent_of,
        draw=lookup(dpath="seed", within=config),
        seed=lambda wildcards: int(wildcards.seed),
        code=fingerprint("train_regressor", [t.module for t in models.TEACHERS.values()]),
    message:
        "Learning the latent voltages of a state, {wildcards.dataset}: {wildcards.setting}, seed {wildcards.seed}"


use rule train_predictor as ablation_predictor with:
    input:
        dataset="results/datasets/{dataset}.parquet",
        split="results/splits/{dataset}/{split}.parquet",
        teachers=taught_by(lambda wildcards: wildcards.setting),
    output:
        temp(f"{ABLATION}/{{setting}}/{{model}}/{{seed}}.pt"),
    log:
        "logs/ablation_predictor/{dataset}/{split}/{budget}/{setting}/{model}/{seed}.log",
    benchmark:
        "logs/benchmarks/ablation_predictor/{dataset}/{split}/{budget}/{setting}/{model}/{seed}.tsv"
    wildcard_constraints:
        setting=any_of(SETTINGS | POINTS),
    group:
        "ablation"
    params:
        recipe=recipe_of_setting,
        budget=spent_of,
        draw=lookup(dpath="seed", within=config),
        seed=lambda wildcards: int(wildcards.seed),
        code=of_model("train_predictor"),
    message:
        "Training {wildcards.model} on {wildcards.dataset}, {wildcards.split}: {wildcards.setting}, seed {wildcards.seed}"


rule ablation_choice:
    """The setting of a model with the least validation error."""
    input:
        errors=lambda wildcards: expand(
            f"{ABLATION}/{{setting}}/{{model}}.csv", setting=GRIDS[wildcards.size], **wildcards
        ),
    output:
        f"{ABLATION}/tuned-{{size}}/{{model}}.json",
    log:
        "logs/ablation_choice/{dataset}/{split}/{budget}/{size}/{model}.log",
    benchmark:
        "logs/benchmarks/ablation_choice/{dataset}/{split}/{budget}/{size}/{model}.tsv"
    wildcard_constraints:
        size=any_of(SIZES),
    localrule: True
    conda:
        "../../envs/learning.yaml"
    threads: 1
    resources:
        mem_mb=500,
        runtime=5,
    params:
        grid=lambda wildcards: GRIDS[wildcards.size],
        axes=list(STUDIED["grid"]),
        recipes=lambda wildcards: {
            name: recipe(training_of(name, wildcards.model), wildcards.model)
            for name in GRIDS[wildcards.size]
        },
        code=fingerprint("ablation_choice"),
    message:
        "Choosing the setting of {wildcards.model}, hidden {wildcards.size}, on {wildcards.dataset}, {wildcards.split}"
    script:
        "../scripts/ablation_choice.py"


rule ablation_tuned:
    """A network of a model at its chosen setting."""
    input:
        dataset="results/datasets/{dataset}.parquet",
        split="results/splits/{dataset}/{split}.parquet",
        teachers=taught_by(lambda wildcards: ablation.DEFAULT),
        choice=rules.ablation_choice.output[0],
    output:
        temp(f"{ABLATION}/tuned-{{size}}/{{model}}/{{seed}}.pt"),
    log:
        "logs/ablation_tuned/{dataset}/{split}/{budget}/{size}/{model}/{seed}.log",
    benchmark:
        "logs/benchmarks/ablation_tuned/{dataset}/{split}/{budget}/{size}/{model}/{seed}.tsv"
    wildcard_constraints:
        size=any_of(SIZES),
    conda:
        "../../envs/learning.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=240,
    params:
        budget=rules.train_predictor.params.budget,
        draw=lookup(dpath="seed", within=config),
        seed=lambda wildcards: int(wildcards.seed),
        code=of_model("ablation_tuned"),
    message:
        "Training {wildcards.model} on {wildcards.dataset}, {wildcards.split}, as tuned, seed {wildcards.seed}"
    script:
        "../scripts/ablation_tuned.py"


rule ablation_errors:
    """Test errors of a model at one setting."""
    input:
        dataset="results/datasets/{dataset}.parquet",
        split="results/splits/{dataset}/{split}.parquet",
        models=models_of_setting,
    output:
        f"{ABLATION}/{{setting}}/{{model}}.csv",
    log:
        "logs/ablation_errors/{dataset}/{split}/{budget}/{setting}/{model}.log",
    benchmark:
        "logs/benchmarks/ablation_errors/{dataset}/{split}/{budget}/{setting}/{model}.tsv"
    wildcard_constraints:
        setting=any_of([*SETTINGS, *POINTS, *(f"tuned-{size}" for size in SIZES)]),
    conda:
        "../../envs/learning.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=10,
    params:
        part=lambda wildcards: "validation" if wildcards.setting in POINTS else "test",
        code=of_model("ablation_errors"),
    message:
        "Testing {wildcards.model} on {wildcards.dataset}, {wildcards.split}: {wildcards.setting}"
    script:
        "../scripts/ablation_errors.py"


rule ablation:
    """Table of what the choices in training are worth."""
    input:
        varied=[
            f"{ABLATION}/{{setting}}/{ablation.INFORMED}.csv".format(
                **study, budget=config["budget"]
            )
            for study in STUDIES
        ],
        plain=[f"{TUNED}/{ablation.PLAIN}.csv".format(**one) for one in COMPARED],
        informed=[f"{TUNED}/{ablation.INFORMED}.csv".format(**one) for one in COMPARED],
        plain_setting=[f"{TUNED}/{ablation.PLAIN}.json".format(**one) for one in COMPARED],
        informed_setting=[f"{TUNED}/{ablation.INFORMED}.json".format(**one) for one in COMPARED],
    output:
        varied=report(
            "results/tables/ablation.csv",
            caption="../report/ablation.rst",
            category="7 Ablation",
            labels={"shows": "each choice varied alone"},
        ),
        compared=report(
            "results/tables/latent_loss.csv",
            caption="../report/ablation.rst",
            category="7 Ablation",
            labels={"shows": "whether the latent loss helps"},
        ),
        markdown=report(
            "results/tables/ablation.md",
            caption="../report/ablation.rst",
            category="7 Ablation",
            labels={"shows": "both, for reading"},
        ),
    log:
        "logs/ablation.log",
    benchmark:
        "logs/benchmarks/ablation.tsv"
    localrule: True
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
        code=fingerprint("ablation"),
    message:
        "Collecting what the choices in training are worth"
    script:
        "../scripts/ablation.py"


rule tuning:
    """Table of validation errors at every point of the grid."""
    input:
        errors=[
            f"{ABLATION}/{{setting}}/{{model}}.csv".format(**one, budget=config["budget"])
            for one in TUNING
        ],
    output:
        "results/tables/tuning.csv",
    log:
        "logs/tuning.log",
    benchmark:
        "logs/benchmarks/tuning.tsv"
    localrule: True
    conda:
        "../../envs/learning.yaml"
    threads: 1
    resources:
        mem_mb=500,
        runtime=5,
    params:
        points=TUNING,
        grid=POINTS,
        budget=config["budget"],
        code=fingerprint("tuning", []),
    message:
        "Collecting how models do on the validation part at every point of the grid"
    script:
        "../scripts/tuning.py"

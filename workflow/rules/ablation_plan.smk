from eitskin.paper import ablation

# What is varied, the settings that come of it, and the grids in which models are tuned alike, by size.
STUDIED = config["ablation"]
VARIED = {**STUDIED["varied"], "samples": STUDIED["samples"]}
OWN = chosen(config["training"], ablation.INFORMED) | {
    "samples": chosen(config["budgets"][config["budget"]], ablation.INFORMED)["samples"]
}
SETTINGS = ablation.settings(OWN, VARIED)
SIZES = {ablation.size(widths): widths for widths in STUDIED["widths"]}
GRIDS = {size: ablation.grid(STUDIED["grid"], widths) for size, widths in SIZES.items()}
POINTS = {name: point for points in GRIDS.values() for name, point in points.items()}
ABLATION = "results/ablation/{dataset}/{split}/{budget}"


def teachers_of(setting):
    """The autoencoder's and the regressor's files: Table I's, where the setting does not touch them."""
    folder = f"{ABLATION}/{setting}" if ablation.has_own_teachers(setting) else MODELS
    return [f"{folder}/autoencoder/{{seed}}.pt", f"{folder}/regressor/{{seed}}.pt"]


def taught_by(setting_of_job):
    """An input function: the teachers of a model, as many as it has."""

    def files(wildcards):
        needed = 2 if informed(wildcards) else int(models.model(wildcards.model).encoder)
        return teachers_of(setting_of_job(wildcards))[:needed]

    return files


def training_of(setting, model=None):
    """The settings of `training` for a model, or for the teachers, but for what a setting has."""
    return chosen(config["training"], model) | (SETTINGS | POINTS)[setting]


def recipe_of_setting(wildcards):
    return recipe(training_of(wildcards.setting, wildcards.model), wildcards.model)


def spent_of(wildcards):
    """The budget of a job, with the samples of its setting."""
    own = {key: v for key, v in (SETTINGS | POINTS)[wildcards.setting].items() if key == "samples"}
    return spent(config["budgets"][wildcards.budget], wildcards.get("model")) | own


def models_of_setting(wildcards):
    """The files of all seeds; points of the grid have fewer, what is compared has as many as its peer."""
    budget = config["budgets"][wildcards.budget]
    own = seeds(wildcards.model, budget)
    if wildcards.setting in POINTS:
        own = own[: STUDIED["tuning_seeds"]]
    elif wildcards.setting not in SETTINGS:
        own = min((seeds(name, budget) for name in ablation.PAIR), key=len)
    folder = f"{ABLATION}/{wildcards.setting}/{wildcards.model}"
    return expand(f"{folder}/{{seed}}.pt", seed=own, **wildcards)


def points_of(model):
    """The grid of a model: of every size, where it has one."""
    return POINTS if models.model(model).perceptron else GRIDS[next(iter(GRIDS))]


STUDIES = [
    {"study": study, "value": value, "setting": setting, "dataset": dataset, "split": split}
    for dataset, splits in STUDIED["varied_on"].items()
    for split in splits
    for study, value, setting in ablation.studies(OWN, VARIED)
]
COMPARED = [
    {"dataset": dataset, "split": split, "widths": size}
    for dataset, splits in STUDIED["compared_on"].items()
    for split in splits
    for size in SIZES
]
TUNED = f"{ABLATION}/tuned-{{widths}}".replace("{budget}", config["budget"])
TUNING = [
    {"dataset": dataset, "split": split, "model": model, "setting": setting}
    for dataset, splits in STUDIED["varied_on"].items()
    for split in splits
    for model in STUDIED["tuned"]
    for setting in points_of(model)
]

import re

from eitskin.paper import ablation

# By budget: what is varied, the settings that come of it, and the grid in which both are tuned.
VARIED = {
    budget: {**config["ablation"]["varied"], "samples": config["ablation"][budget]["samples"]}
    for budget in config["budgets"]
}
SETTINGS = {
    budget: ablation.settings(config["training"], item["samples"], VARIED[budget])
    for budget, item in config["budgets"].items()
}
GRIDS = {
    budget: ablation.grid(config["training"], item["samples"], config["ablation"][budget]["grid"])
    for budget, item in config["budgets"].items()
}
ABLATION = "results/ablation/{dataset}/{split}/{budget}"


def any_of(named):
    return "|".join(sorted({re.escape(name) for names in named.values() for name in names}))


def teachers_of(setting):
    """The autoencoder's and the regressor's files: Table I's, where the setting does not touch them."""
    folder = f"{ABLATION}/{setting}" if ablation.has_own_teachers(setting) else MODELS
    return [f"{folder}/autoencoder/{{seed}}.pt", f"{folder}/regressor/{{seed}}.pt"]


def taught_by(setting_of_job):
    """An input function: the teachers of a model that has some."""
    return lambda wildcards: teachers_of(setting_of_job(wildcards)) if informed(wildcards) else []


def setting_of(wildcards):
    return (SETTINGS[wildcards.budget] | GRIDS[wildcards.budget])[wildcards.setting]


def optimiser_of(wildcards):
    setting = setting_of(wildcards)
    return {key: setting[key] for key in OPTIMISER}


def spent_of(wildcards):
    budget = config["budgets"][wildcards.budget]
    return spent(budget, samples=setting_of(wildcards)["samples"])


def models_of_setting(wildcards):
    """The files of all seeds; points of the grid have fewer."""
    budget = config["budgets"][wildcards.budget]
    if wildcards.setting in GRIDS[wildcards.budget]:
        most = config["ablation"][wildcards.budget]["tuning_seeds"]
        budget = budget | {"seeds": min(budget["seeds"], most)}
    folder = f"{ABLATION}/{wildcards.setting}/{wildcards.model}"
    return expand(f"{folder}/{{seed}}.pt", seed=seeds(wildcards.model, budget), **wildcards)


ABLATION_BUDGET = config["ablation"][config["budget"]]
STUDIES = [
    {"study": study, "value": value, "setting": setting, "dataset": dataset, "split": split}
    for dataset, splits in ABLATION_BUDGET["varied_on"].items()
    for split in splits
    for study, value, setting in ablation.studies(
        config["training"], config["budgets"][config["budget"]]["samples"], VARIED[config["budget"]]
    )
]
COMPARED = [
    {"dataset": dataset, "split": split}
    for dataset, splits in ABLATION_BUDGET["compared_on"].items()
    for split in splits
]
TUNED = f"{ABLATION}/tuned".replace("{budget}", config["budget"])

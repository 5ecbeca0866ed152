import re

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
    folder = (
        f"{ABLATION}/{setting}"
        if ablation.has_own_teachers(setting)
        else "results/models/{dataset}/{split}/{budget}"
    )
    return [f"{folder}/autoencoder.pt", f"{folder}/regressor.pt"]


def setting_of(wildcards):
    return (SETTINGS[wildcards.budget] | GRIDS[wildcards.budget])[wildcards.setting]


def budget_of(wildcards):
    """The budget in use; points of the grid have fewer seeds."""
    seeds = config["budgets"][wildcards.budget]["seeds"]
    if wildcards.setting in GRIDS[wildcards.budget]:
        seeds = min(seeds, config["ablation"][wildcards.budget]["tuning_seeds"])
    samples = setting_of(wildcards)["samples"]
    return config["budgets"][wildcards.budget] | {"samples": samples, "seeds": seeds}


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

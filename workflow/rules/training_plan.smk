# What is trained: which seeds, for how much, by which teachers.
from eitskin.learn import models

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

# What is trained: which seeds, for how much, how, by which teachers.
from eitskin.learn import models

MODELS = "results/models/{dataset}/{split}/{budget}"
OPTIMISER = ("learning_rate", "weight_decay", "batch_size", "schedule")


def chosen(settings, model):
    """Settings, and what is other for one model."""
    rows = settings.get("rows", {})
    return {key: value for key, value in settings.items() if key != "rows"} | rows.get(model, {})


def optimiser(training):
    """Adam's settings among those of a training, a model's or the teachers'."""
    return {key: training[key] for key in OPTIMISER}


def spent(budget, model=None):
    """What one seed of a budget costs, of a model or of a teacher; what is fitted at once has no epochs."""
    own = chosen(budget, model) | ({"epochs": 0} if model and fitted_at_once(model) else {})
    return {key: own[key] for key in ("samples", "epochs", "validated") if key in own}


def seeds(model, budget):
    """The seeds that a budget trains; of what is fitted at once, one."""
    count = 1 if fitted_at_once(model) else chosen(budget, model)["seeds"]
    return range(config["seed"], config["seed"] + count)


def of_all_seeds(template):
    """An input function: the files of all seeds of a model."""

    def files(wildcards):
        own = seeds(wildcards.model, config["budgets"][wildcards.budget])
        return expand(template, seed=own, **wildcards)

    return files


def informed(wildcards):
    return wildcards.model.startswith(models.PHYSICS_INFORMED)


def fitted_at_once(model):
    """Whether a model is support vectors, of which nothing is drawn but the samples."""
    return models.model(model).support_vectors


def recipe(own, model):
    """Of the settings that a model is trained with, those that it knows: Adam's, the weights of the
    loss, the widths."""
    known = models.model(model)
    if known.support_vectors:
        return {"optimiser": {}, "force_weight": 1.0}
    informed = model.startswith(models.PHYSICS_INFORMED)
    return {
        "optimiser": optimiser(own),
        "force_weight": own["force_weight"],
        "lambda_latent": own["lambda_latent"] if informed else 0.0,
    } | ({"widths": own["widths"]} if known.perceptron else {})


def recipe_of_row(wildcards):
    """The recipe of a row of Table I."""
    return recipe(chosen(config["training"], wildcards.model), wildcards.model)

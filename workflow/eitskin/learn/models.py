"""The models of Table I by name. Networks are imported only when they are made."""

import importlib
from collections.abc import Callable
from dataclasses import dataclass

from eitskin.errors import InputError


@dataclass(frozen=True)
class Model:
    """`factory`: the function, module.name of this package, that makes the model from a
    `networks.Shape`; encoder: whether its `encoder` is that of a trained autoencoder, frozen;
    support_vectors: whether it is fitted as such, else it is trained by gradients; perceptron:
    whether its hidden widths can be set."""

    factory: str
    encoder: bool = False
    support_vectors: bool = False
    perceptron: bool = False

    @property
    def module(self) -> str:
        """The module of the factory."""
        return f"eitskin.learn.{self.factory.rpartition('.')[0]}"

    @property
    def make(self) -> Callable:
        """The factory."""
        return getattr(importlib.import_module(self.module), self.factory.rpartition(".")[2])


MODELS = {  # in the order of the paper's table
    "svr": Model("networks.svr.svr", support_vectors=True),
    "mlp": Model("networks.mlp.mlp", perceptron=True),
    "cnn": Model("networks.cnn.cnn"),
    "transformer": Model("networks.transformer.drive_transformer"),
    "transformer-channels": Model("networks.transformer.channel_transformer"),
    "autoencoder-mlp": Model(
        "networks.autoencoder_mlp.autoencoder_mlp", encoder=True, perceptron=True
    ),
    "cnn-transformer": Model("networks.cnn_transformer.cnn_transformer"),
}
TEACHERS = {
    "autoencoder": Model("networks.teachers.Autoencoder"),
    "regressor": Model("networks.teachers.StateToLatent"),
}
PHYSICS_INFORMED = "physics-informed-"  # before any network's name: trained by equation 8


def names() -> list[str]:
    """Every model's name, then those of the networks trained with equation 8."""
    networks = [name for name, model in MODELS.items() if not model.support_vectors]
    return [*MODELS, *(PHYSICS_INFORMED + name for name in networks)]


def model(name: str) -> Model:
    """The model of a name; raises InputError for an unknown one."""
    if name not in names():
        raise InputError("models", "name", repr(name), f"one of {', '.join(names())}")
    return MODELS[name.removeprefix(PHYSICS_INFORMED)]


def modules(name: str) -> list[str]:
    """The modules of a model and, where it has teachers, of these; raises InputError for an unknown
    one."""
    row = model(name)
    has_teachers = row.encoder or name.startswith(PHYSICS_INFORMED)
    return [row.module, *(t.module for t in TEACHERS.values() if has_teachers)]

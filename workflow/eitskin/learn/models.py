"""The models of Table I by name, a line each. What asks for names alone imports no network."""

import importlib
from collections.abc import Callable
from dataclasses import dataclass

from eitskin.errors import InputError


@dataclass(frozen=True)
class Model:
    """`made_by`: the function, module.name of this package, that makes it of a `networks.Shape`;
    encoder: whether its `encoder` is a trained autoencoder's, which it keeps; support_vectors:
    whether these are fitted, else gradients train it, by equation 8 too; perceptron: whether its
    hidden widths may be chosen."""

    made_by: str
    encoder: bool = False
    support_vectors: bool = False
    perceptron: bool = False

    @property
    def module(self) -> str:
        """The module of that function."""
        return f"eitskin.learn.{self.made_by.partition('.')[0]}"

    @property
    def make(self) -> Callable:
        """The function that makes it."""
        return getattr(importlib.import_module(self.module), self.made_by.partition(".")[2])


MODELS = {  # in the order of the paper's table
    "svr": Model("networks.svr", support_vectors=True),
    "mlp": Model("networks.mlp", perceptron=True),
    "cnn": Model("networks.cnn"),
    "transformer": Model("networks.drive_transformer"),
    "transformer-channels": Model("networks.channel_transformer"),
    "autoencoder-mlp": Model("networks.autoencoder_mlp", encoder=True, perceptron=True),
    "cnn-transformer": Model("networks.cnn_transformer"),
}
PHYSICS_INFORMED = "physics-informed-"  # before any network's name: trained by equation 8


def names() -> list[str]:
    """Every model's name, then those of networks that are trained by equation 8."""
    networks = [name for name, model in MODELS.items() if not model.support_vectors]
    return [*MODELS, *(PHYSICS_INFORMED + name for name in networks)]


def model(name: str) -> Model:
    """A model by its row's name in the table; raises InputError for an unknown one."""
    if name not in names():
        raise InputError("models", "name", repr(name), f"one of {', '.join(names())}")
    return MODELS[name.removeprefix(PHYSICS_INFORMED)]

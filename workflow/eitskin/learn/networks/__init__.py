"""Predictors from voltages to contact states, the rows of the paper's Table I, a file each, and the
two networks that teach the physics-informed ones. Widths and depths are the paper's (§ III-C),
except for perceptrons with other widths; each docstring names the choices that the paper leaves
open. An edit of one trains again what is made of it alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn

from eitskin.learn import models

CHUNK = 256  # samples evaluated at once: attention over 208 tokens takes 0.7 MB a sample
HIDDEN = (256, 128, 64)  # widths of the paper's perceptron


@dataclass(frozen=True)
class Shape:
    """The sizes of a predictor: the name of its `dataset`, `n_channels` M, `n_targets` T and, where
    known, the table of the `channels` (M rows of source, sink, plus, minus), the autoencoder's
    `latent_dim` K and a perceptron's hidden `widths`."""

    dataset: str
    n_channels: int
    n_targets: int
    channels: list[list[int]] | None = None
    latent_dim: int | None = None
    widths: Sequence[int] = HIDDEN

    @classmethod
    def from_header(cls, header: dict, n_channels: int) -> "Shape":
        """The shape in a model file's header."""
        dataset = header["dataset"]
        sizes = (n_channels, len(dataset["targets"]))
        widths = header.get("widths", HIDDEN)
        return cls(
            dataset["name"], *sizes, dataset.get("channels"), header.get("latent_dim"), widths
        )


def layers(*widths: int) -> nn.Sequential:
    """Linear layers of these widths with a ReLU between any two."""
    steps: list[nn.Module] = []
    for k, (width, next_wide) in enumerate(pairwise(widths)):
        steps += [nn.ReLU()] * (k > 0) + [nn.Linear(width, next_wide)]
    return nn.Sequential(*steps)


def predictor(name: str, shape: Shape) -> nn.Module:
    """A new predictor of a name; raises InputError for an unknown name and for a shape that the
    predictor cannot have."""
    return models.model(name).make(shape)


def in_chunks(module: nn.Module, voltage: Tensor) -> Tensor:
    """States (N, T) of standardised voltages (N, M), evaluated in chunks."""
    return torch.cat([module(chunk) for chunk in voltage.split(CHUNK)])

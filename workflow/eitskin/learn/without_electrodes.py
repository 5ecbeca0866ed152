"""A perceptron that estimates touches while one electrode or two are lost.

It sees a change whose missing channels are what the others say, and which electrodes are lost: the
frozen predictor, given such changes, is far from what the channels that are left allow, as it leans
on channels that are no measurement any more.
"""

from itertools import combinations

import numpy as np
import torch
from torch import Tensor, nn

from eitskin.exported.channels import Channels
from eitskin.exported.electrodes import using
from eitskin.learn import networks
from eitskin.learn.predict import unstandardised
from eitskin.learn.train import Budget, Optimiser, deterministic, fit, standardise

WIDTHS = (512, 256, 128)  # the recipe's, of `config.yaml`
OPTIMISER = Optimiser(learning_rate=2e-3)
SINGLE = 0.6  # share of batches that lack one electrode; the others lack two


def sets_of(electrodes: int) -> list[tuple[int, ...]]:
    """Every electrode and every two of them."""
    return [one for size in (1, 2) for one in combinations(range(electrodes), size)]


class Without(nn.Module):
    """(B, M + n) float64, changes and a 1 for each lost electrode of n → states (B, T)."""

    def __init__(self, scalers: dict[str, Tensor], electrodes: int):
        super().__init__()
        self.scalers, self.electrodes = scalers, electrodes
        sizes = len(scalers["voltage_mean"]) + electrodes, len(scalers["state_mean"])
        self.net = networks.Mlp(*sizes, WIDTHS)

    def standardised(self, given: Tensor) -> Tensor:
        """What the network takes (B, M + n) float32."""
        change, lost = given.tensor_split([-self.electrodes], dim=1)
        return torch.cat([standardise(change, self.scalers, "voltage"), lost.float()], dim=1)

    def forward(self, given: Tensor) -> Tensor:
        return unstandardised(self.net(self.standardised(given)), self.scalers)


def train(
    change: np.ndarray,
    state: np.ndarray,
    channels: Channels,
    table: np.ndarray,
    scalers: dict[str, Tensor],
    epochs: int,
    seed: int,
) -> Without:
    """The perceptron, trained on changes (N, M) and states (N, T); every batch lacks a set of
    electrodes of its own, drawn by the seed. The model's scalers; its voltage scale is the unit of
    `channels`."""
    deterministic()
    electrodes = int(table.max()) + 1
    sets = sets_of(electrodes)
    gone = [np.flatnonzero(using(table, lost)) for lost in sets]
    torch.manual_seed(seed)
    module, draw = Without(scalers, electrodes), np.random.default_rng(seed)
    scale = scalers["voltage_scale"].numpy()

    def loss(net: nn.Module, z: Tensor, target: Tensor) -> Tensor:
        alone = draw.random() < SINGLE
        k = int(draw.integers(electrodes) if alone else draw.integers(electrodes, len(sets)))
        which = np.zeros((len(z), electrodes))
        which[:, sets[k]] = 1.0
        given = np.hstack([channels.filled_alike(z.numpy(), gone[k]) * scale, which])
        return (net(module.standardised(torch.from_numpy(given))) - target).square().mean()

    part = torch.from_numpy(change / scale), standardise(torch.from_numpy(state), scalers, "state")
    checked = [values[:2] for values in part]  # nothing is chosen by it
    fit(module.net, part, checked, loss, OPTIMISER, Budget(None, epochs, validated=False), seed)
    return module.eval().requires_grad_(False)

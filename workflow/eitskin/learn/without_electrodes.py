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
from eitskin.exported.electrodes import channels_using
from eitskin.learn import networks
from eitskin.learn.predict import unstandardised
from eitskin.learn.train import Budget, Optimiser, deterministic, fit, standardise

WIDTHS = (512, 256, 128)  # the recipe's, of `config.yaml`
OPTIMISER = Optimiser(learning_rate=2e-3)
SINGLE = 0.6  # share of touches that lack one electrode; the others lack two


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


class _Lacking:
    """What the network takes of changes z (N, M) in units of `channels`, each touch without a set
    of electrodes of its own, all drawn anew after N touches were asked for."""

    def __init__(
        self, module: Without, z: np.ndarray, channels: Channels, table: np.ndarray, seed: int
    ):
        self.module, self.z, self.channels = module, z, channels
        self.sets = sets_of(module.electrodes)
        self.gone = [np.flatnonzero(channels_using(table, lost)) for lost in self.sets]
        self.scale = module.scalers["voltage_scale"].numpy()
        self.draw = np.random.default_rng(seed)
        self.given = torch.empty(len(z), z.shape[1] + module.electrodes)
        self.left = 0

    def __call__(self, rows: Tensor) -> Tensor:
        """(B, M + n) float32 of touches rows (B,)."""
        if self.left <= 0:
            self._draw_anew()
        self.left -= len(rows)
        return self.given[rows]

    def _draw_anew(self) -> None:
        electrodes, count = self.module.electrodes, len(self.z)
        single = self.draw.integers(electrodes, size=count)
        double = self.draw.integers(electrodes, len(self.sets), size=count)
        own = np.where(self.draw.random(count) < SINGLE, single, double)
        for k in np.unique(own).tolist():
            rows = np.flatnonzero(own == k)
            which = np.zeros((len(rows), electrodes))
            which[:, self.sets[k]] = 1.0
            filled = self.channels.filled_together(self.z[rows], self.gone[k]) * self.scale
            given = torch.from_numpy(np.hstack([filled, which]))
            self.given[rows] = self.module.standardised(given)
        self.left = count


def train(
    change: np.ndarray,
    state: np.ndarray,
    channels: Channels,
    table: np.ndarray,
    scalers: dict[str, Tensor],
    epochs: int,
    seed: int,
) -> Without:
    """The perceptron, trained on changes (N, M) and states (N, T); in every epoch each touch lacks
    a set of electrodes of its own, drawn by the seed. The model's scalers; its voltage scale is the
    unit of `channels`."""
    deterministic()
    torch.manual_seed(seed)
    module = Without(scalers, int(table.max()) + 1)
    z = change / scalers["voltage_scale"].numpy()
    lacking = _Lacking(module, z, channels, table, seed)

    def loss(net: nn.Module, rows: Tensor, target: Tensor) -> Tensor:
        return (net(lacking(rows)) - target).square().mean()

    target = standardise(torch.from_numpy(state), scalers, "state")
    part = torch.arange(len(z)), target
    checked = [values[:2] for values in part]  # nothing is chosen by it
    fit(module.net, part, checked, loss, OPTIMISER, Budget(None, epochs, validated=False), seed)
    return module.eval().requires_grad_(False)

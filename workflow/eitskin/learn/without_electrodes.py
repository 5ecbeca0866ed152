"""A perceptron that estimates touches while one electrode or two are lost.

Its input is a change whose missing channels are at their conditional mean, and an indicator of the
lost electrodes. The predictor trained on all channels errs more on such changes than the measured
channels allow, as it relies on channels that are no longer measured.
"""

from itertools import combinations

import numpy as np
import torch
from torch import Tensor, nn

from eitskin.exported.channels import Channels
from eitskin.exported.electrodes import channels_using
from eitskin.learn.networks.mlp import Mlp
from eitskin.learn.predict import unstandardised
from eitskin.learn.train import Budget, Optimiser, deterministic, fit, standardise

WIDTHS = (512, 256, 128)  # of the recipe in `config.yaml`
OPTIMISER = Optimiser(learning_rate=2e-3)  # of the same recipe
SINGLE_SHARE = 0.6  # share of touches that lack one electrode; the others lack two


def electrode_sets(electrodes: int) -> list[tuple[int, ...]]:
    """Every single electrode and every pair of them."""
    return [
        electrodes_lost
        for size in (1, 2)
        for electrodes_lost in combinations(range(electrodes), size)
    ]


class Without(nn.Module):
    """(B, M + n) float64, changes and an indicator of the lost of n electrodes → states (B, T)."""

    def __init__(self, scalers: dict[str, Tensor], electrodes: int):
        super().__init__()
        self.scalers, self.electrodes = scalers, electrodes
        sizes = len(scalers["voltage_mean"]) + electrodes, len(scalers["state_mean"])
        self.net = Mlp(*sizes, WIDTHS)

    def standardised(self, inputs: Tensor) -> Tensor:
        """The network's inputs (B, M + n) float32."""
        change, lost = inputs.tensor_split([-self.electrodes], dim=1)
        return torch.cat([standardise(change, self.scalers, "voltage"), lost.float()], dim=1)

    def forward(self, inputs: Tensor) -> Tensor:
        return unstandardised(self.net(self.standardised(inputs)), self.scalers)


class _DrawnSets:
    """The network's inputs of changes z (N, M) in units of `channels`, each touch with a random set
    of lost electrodes; the sets are drawn again after every N touches."""

    def __init__(
        self, module: Without, z: np.ndarray, channels: Channels, table: np.ndarray, seed: int
    ):
        self.module, self.z, self.channels = module, z, channels
        self.sets = electrode_sets(module.electrodes)
        self.missing_channels = [
            np.flatnonzero(channels_using(table, lost_electrodes)) for lost_electrodes in self.sets
        ]
        self.scale = module.scalers["voltage_scale"].numpy()
        self.rng = np.random.default_rng(seed)
        self.inputs = torch.empty(len(z), z.shape[1] + module.electrodes)
        self.remaining = 0

    def __call__(self, rows: Tensor) -> Tensor:
        """(B, M + n) float32 of touches rows (B,)."""
        if self.remaining <= 0:
            self._redraw()
        self.remaining -= len(rows)
        return self.inputs[rows]

    def _redraw(self) -> None:
        electrodes, count = self.module.electrodes, len(self.z)
        single = self.rng.integers(electrodes, size=count)
        double = self.rng.integers(electrodes, len(self.sets), size=count)
        set_index = np.where(self.rng.random(count) < SINGLE_SHARE, single, double)
        for set_number in np.unique(set_index).tolist():
            rows = np.flatnonzero(set_index == set_number)
            lost_indicator = np.zeros((len(rows), electrodes))
            lost_indicator[:, self.sets[set_number]] = 1.0
            filled = (
                self.channels.filled_together(self.z[rows], self.missing_channels[set_number])
                * self.scale
            )
            inputs = torch.from_numpy(np.hstack([filled, lost_indicator]))
            self.inputs[rows] = self.module.standardised(inputs)
        self.remaining = count


def train(
    samples: tuple[np.ndarray, np.ndarray],
    channels: Channels,
    table: np.ndarray,
    scalers: dict[str, Tensor],
    epochs: int,
    seed: int,
) -> Without:
    """The perceptron, trained on changes (N, M) and states (N, T). In every epoch each touch lacks
    another set of electrodes, drawn with the seed. scalers: the model's, whose voltage scale is the
    unit of `channels`; table (M, 4): of the channels."""
    change, state = samples
    deterministic()
    torch.manual_seed(seed)
    module = Without(scalers, int(table.max()) + 1)
    scaled_change = change / scalers["voltage_scale"].numpy()
    lacking = _DrawnSets(module, scaled_change, channels, table, seed)

    def loss(net: nn.Module, rows: Tensor, target: Tensor) -> Tensor:
        return (net(lacking(rows)) - target).square().mean()

    target = standardise(torch.from_numpy(state), scalers, "state")
    training = torch.arange(len(scaled_change)), target
    validation = [tensor[:2] for tensor in training]  # `fit` needs some; they choose nothing
    budget = Budget(None, epochs, validated=False)
    fit(module.net, (training, validation), loss, OPTIMISER, budget, seed)
    return module.eval().requires_grad_(False)

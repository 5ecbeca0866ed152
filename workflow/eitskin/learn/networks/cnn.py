"""The CNN."""

from torch import Tensor, nn

from eitskin.learn.networks import Shape, layers
from eitskin.learn.networks.convolutions import convolutions


class Cnn(nn.Module):
    """Voltages (B, M), in the order of their table, through convolutions of 64, 128, 256 and dense
    layers of 128, 64 → states (B, T)."""

    def __init__(self, n_channels: int, n_targets: int):
        super().__init__()
        self.features = convolutions(n_channels, 64, 128, 256)
        self.head = layers(n_channels // 8 * 256, 128, 64, n_targets)

    def forward(self, voltage: Tensor) -> Tensor:
        return self.head(self.features(voltage[:, None]).flatten(1))


def cnn(shape: Shape) -> Cnn:
    """The paper's CNN."""
    return Cnn(shape.n_channels, shape.n_targets)

"""The multilayer perceptron."""

from collections.abc import Sequence

from torch import Tensor, nn

from eitskin.learn.networks import HIDDEN, Shape, layers


class Mlp(nn.Module):
    """f_θ: voltages (B, M) → states (B, T), hidden layers of `widths`."""

    def __init__(self, n_channels: int, n_targets: int, widths: Sequence[int] = HIDDEN):
        super().__init__()
        self.net = layers(n_channels, *widths, n_targets)

    def forward(self, voltage: Tensor) -> Tensor:
        return self.net(voltage)


def mlp(shape: Shape) -> Mlp:
    """The MLP, of the shape's widths."""
    return Mlp(shape.n_channels, shape.n_targets, shape.widths)

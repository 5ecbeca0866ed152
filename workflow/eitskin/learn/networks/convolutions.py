"""Blocks of convolutions."""

from itertools import pairwise

from torch import Tensor, nn

from eitskin.errors import InputError


class Halve(nn.Module):
    """(B, C, L) → (B, C, L // 2): the maximum of two neighbours. Unlike PyTorch's pooling its
    gradients are deterministic on every device; of the forms with this property it trains fastest.
    """

    def forward(self, value: Tensor) -> Tensor:
        a, b = value[..., : value.shape[-1] // 2 * 2].unflatten(-1, (-1, 2)).unbind(-1)
        return a + (b - a).relu()


def convolutions(n_channels: int, *widths: int) -> nn.Sequential:
    """(B, 1, M) → (B, last width, M // 2^blocks): one block for each width, of a convolution of
    kernel 3, the maximum of two neighbours, ReLU (which commutes with it) and batch normalisation.
    Raises InputError where M is too small for the blocks."""
    if n_channels < 2 ** len(widths):
        expected = f"{2 ** len(widths)} or more, halved {len(widths)} times"
        raise InputError("models", "channels", n_channels, expected)
    steps: list[nn.Module] = []
    for width, next_width in pairwise((1, *widths)):
        steps += [nn.Conv1d(width, next_width, 3, padding=1), Halve()]
        steps += [nn.ReLU(), nn.BatchNorm1d(next_width)]
    return nn.Sequential(*steps)

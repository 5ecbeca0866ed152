"""Transformers, whose tokens are drives or channels."""

import numpy as np
import pandas as pd
import torch
from torch import Tensor, nn

from eitskin.errors import InputError
from eitskin.learn.networks import Shape
from eitskin.learn.networks.tokens import WIDTH, TokenEncoder


class Transformer(nn.Module):
    """Voltages (B, M), grouped into tokens, through the encoder and a linear layer → states (B, T).

    `tokens` (L, W) int: the channels of each token, M for an empty slot, which reads 0.
    """

    tokens: Tensor

    def __init__(self, tokens: Tensor, n_targets: int):
        super().__init__()
        self.register_buffer("tokens", tokens, persistent=False)
        self.encoder = TokenEncoder(*tokens.shape)
        self.head = nn.Linear(WIDTH, n_targets)

    def forward(self, voltage: Tensor) -> Tensor:
        slots = nn.functional.pad(voltage, (0, 1))[:, self.tokens]
        return self.head(self.encoder(slots))


def drive_tokens(shape: Shape) -> Tensor:
    """Tokens (drives, measuring pairs) for `Transformer`: the channels of each drive, in the slots
    of their measuring pairs, so that a lost channel leaves an empty slot. A pair that a drive
    measures repeatedly has a slot for each. Raises InputError without a table of M channels."""
    table = np.array(shape.channels or []).reshape(-1, 4)
    if len(table) != shape.n_channels:
        content = f"{len(table)} in the table" if len(table) else "no table"
        expected = f"a table of {shape.n_channels}, as tokens are drives"
        raise InputError(shape.dataset, "channels", content, expected)
    repetition = pd.DataFrame(table).groupby([0, 1, 2, 3]).cumcount()
    drive = np.unique(table[:, :2], axis=0, return_inverse=True)[1]
    slot = np.unique(np.column_stack([table[:, 2:], repetition]), axis=0, return_inverse=True)[1]
    tokens = np.full((drive.max() + 1, slot.max() + 1), shape.n_channels)
    tokens[drive, slot] = np.arange(shape.n_channels)
    return torch.from_numpy(tokens)


def drive_transformer(shape: Shape) -> Transformer:
    """The transformer whose tokens are drives."""
    return Transformer(drive_tokens(shape), shape.n_targets)


def channel_transformer(shape: Shape) -> Transformer:
    """The transformer whose tokens are channels."""
    return Transformer(torch.arange(shape.n_channels)[:, None], shape.n_targets)

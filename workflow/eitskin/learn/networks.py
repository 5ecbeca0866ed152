"""Predictors from voltages to contact states, the rows of the paper's Table I, and the two networks
that teach the physics-informed ones. Widths and depths are the paper's (§ III-C), except for
perceptrons with other widths; each docstring names the choices that the paper leaves open.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pandas as pd
import torch
from torch import Tensor, nn

from eitskin.errors import InputError
from eitskin.learn import models

CHUNK = 256  # samples evaluated at once: attention over 208 tokens takes 0.7 MB a sample
HIDDEN = (256, 128, 64)  # widths of the paper's perceptron
WIDTH = 64  # of a token once embedded, our choice: the paper names none


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


class Mlp(nn.Module):
    """f_θ: voltages (B, M) → states (B, T), hidden layers of `widths`."""

    def __init__(self, n_channels: int, n_targets: int, widths: Sequence[int] = HIDDEN):
        super().__init__()
        self.net = layers(n_channels, *widths, n_targets)

    def forward(self, voltage: Tensor) -> Tensor:
        return self.net(voltage)


class Autoencoder(nn.Module):
    """E_v, D_v: voltages (B, M) → latent (B, K) → voltages, hidden 256, 64 each way."""

    def __init__(self, n_channels: int, latent_dim: int):
        super().__init__()
        self.encoder = layers(n_channels, 256, 64, latent_dim)
        self.decoder = layers(latent_dim, 64, 256, n_channels)

    def forward(self, voltage: Tensor) -> Tensor:
        return self.decoder(self.encoder(voltage))


class StateToLatent(nn.Module):
    """g_φ: states (B, T) → latent (B, K). Hidden 128, 128: our choice, the paper names none."""

    def __init__(self, n_targets: int, latent_dim: int):
        super().__init__()
        self.net = layers(n_targets, 128, 128, latent_dim)

    def forward(self, state: Tensor) -> Tensor:
        return self.net(state)


class AutoencoderMlp(nn.Module):
    """The MLP on the latent voltages of a trained autoencoder, whose encoder is frozen."""

    def __init__(
        self, n_channels: int, n_targets: int, latent_dim: int, widths: Sequence[int] = HIDDEN
    ):
        super().__init__()
        self.encoder = Autoencoder(n_channels, latent_dim).encoder.requires_grad_(False)
        self.mlp = Mlp(latent_dim, n_targets, widths)

    def forward(self, voltage: Tensor) -> Tensor:
        return self.mlp(self.encoder(voltage))


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


class Cnn(nn.Module):
    """Voltages (B, M), in the order of their table, through convolutions of 64, 128, 256 and dense
    layers of 128, 64 → states (B, T)."""

    def __init__(self, n_channels: int, n_targets: int):
        super().__init__()
        self.features = convolutions(n_channels, 64, 128, 256)
        self.head = layers(n_channels // 8 * 256, 128, 64, n_targets)

    def forward(self, voltage: Tensor) -> Tensor:
        return self.head(self.features(voltage[:, None]).flatten(1))


def sinusoids(n_tokens: int, width: int) -> Tensor:
    """Positions (n_tokens, width): sines and cosines in turn, of wavelengths 2π to 10,000 · 2π."""
    rate = torch.exp(torch.arange(0, width, 2) * (-math.log(1e4) / width))
    angle = torch.arange(n_tokens)[:, None] * rate
    return torch.stack([angle.sin(), angle.cos()], dim=-1).flatten(1)


class TokenEncoder(nn.Module):
    """Tokens (B, L, W) → (B, 64): embedded, with sinusoidal positions, two encoder layers of four
    heads and 128 hidden units, averaged. The mean and no dropout are our choice."""

    position: Tensor

    def __init__(self, n_tokens: int, width: int):
        super().__init__()
        self.embedding = nn.Linear(width, WIDTH)
        self.register_buffer("position", sinusoids(n_tokens, WIDTH), persistent=False)
        self.layers = nn.Sequential(
            *(
                nn.TransformerEncoderLayer(WIDTH, 4, 128, dropout=0.0, batch_first=True)
                for _ in range(2)
            )
        )

    def forward(self, tokens: Tensor) -> Tensor:
        return self.layers(self.embedding(tokens) + self.position).mean(dim=1)


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


class CnnTransformer(nn.Module):
    """Convolutions of 64, 128, with every position a token for the encoder, then a dense layer of
    64 → states (B, T). Two blocks and the dense layer's width are our choice."""

    def __init__(self, n_channels: int, n_targets: int):
        super().__init__()
        self.features = convolutions(n_channels, 64, 128)
        self.encoder = TokenEncoder(n_channels // 4, 128)
        self.head = layers(WIDTH, 64, n_targets)

    def forward(self, voltage: Tensor) -> Tensor:
        return self.head(self.encoder(self.features(voltage[:, None]).mT))


class Svr(nn.Module):
    """Fitted support vector regression with a Gaussian kernel, its vectors shared by the targets:
    states (B, T) float64 = Σ_s dual[t, s] exp(-gamma ‖v - support[s]‖²) + intercept[t]."""

    support: Tensor
    dual: Tensor
    intercept: Tensor
    gamma: Tensor

    def __init__(self, n_channels: int, n_targets: int):
        super().__init__()
        self.register_buffer("support", torch.empty(0, n_channels))
        self.register_buffer("dual", torch.empty(n_targets, 0, dtype=torch.float64))
        self.register_buffer("intercept", torch.empty(n_targets, dtype=torch.float64))
        self.register_buffer("gamma", torch.empty((), dtype=torch.float64))

    def _load_from_state_dict(self, state_dict: dict, prefix: str, *arguments: object) -> None:
        """As PyTorch's, with the number of vectors of the file."""
        for name in ("support", "dual"):
            self.register_buffer(name, torch.empty_like(state_dict[prefix + name]))
        super()._load_from_state_dict(state_dict, prefix, *arguments)

    def forward(self, voltage: Tensor) -> Tensor:
        v, s = voltage.double(), self.support.double()
        square = v.square().sum(1, keepdim=True) + s.square().sum(1) - 2 * v @ s.T
        return torch.exp(-self.gamma * square) @ self.dual.T + self.intercept


def svr(shape: Shape) -> Svr:
    """A regression without support vectors."""
    return Svr(shape.n_channels, shape.n_targets)


def mlp(shape: Shape) -> Mlp:
    """The MLP, of the shape's widths."""
    return Mlp(shape.n_channels, shape.n_targets, shape.widths)


def cnn(shape: Shape) -> Cnn:
    """The paper's CNN."""
    return Cnn(shape.n_channels, shape.n_targets)


def drive_transformer(shape: Shape) -> Transformer:
    """The transformer whose tokens are drives."""
    return Transformer(drive_tokens(shape), shape.n_targets)


def channel_transformer(shape: Shape) -> Transformer:
    """The transformer whose tokens are channels."""
    return Transformer(torch.arange(shape.n_channels)[:, None], shape.n_targets)


def autoencoder_mlp(shape: Shape) -> AutoencoderMlp:
    """The MLP on latent voltages. Raises InputError without an autoencoder."""
    if shape.latent_dim is None:
        raise InputError(shape.dataset, "autoencoder", "none", "one, whose encoder the model takes")
    return AutoencoderMlp(shape.n_channels, shape.n_targets, shape.latent_dim, shape.widths)


def cnn_transformer(shape: Shape) -> CnnTransformer:
    """The CNN whose positions are tokens."""
    return CnnTransformer(shape.n_channels, shape.n_targets)


def predictor(name: str, shape: Shape) -> nn.Module:
    """A new predictor of a name; raises InputError for an unknown name and for a shape that the
    predictor cannot have."""
    return models.model(name).make(shape)


def in_chunks(module: nn.Module, voltage: Tensor) -> Tensor:
    """States (N, T) of standardised voltages (N, M), evaluated in chunks."""
    return torch.cat([module(chunk) for chunk in voltage.split(CHUNK)])

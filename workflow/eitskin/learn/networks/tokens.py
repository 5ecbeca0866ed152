"""The encoder of tokens, of transformers."""

import math

import torch
from torch import Tensor, nn

WIDTH = 64  # of a token once embedded, our choice: the paper names none


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

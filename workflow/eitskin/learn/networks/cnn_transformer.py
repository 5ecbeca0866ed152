"""The CNN whose positions are tokens."""

from torch import Tensor, nn

from eitskin.learn.networks import Shape, layers
from eitskin.learn.networks.convolutions import convolutions
from eitskin.learn.networks.tokens import WIDTH, TokenEncoder


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


def cnn_transformer(shape: Shape) -> CnnTransformer:
    """The CNN whose positions are tokens."""
    return CnnTransformer(shape.n_channels, shape.n_targets)

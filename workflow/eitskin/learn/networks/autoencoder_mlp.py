"""The MLP on latent voltages."""

from collections.abc import Sequence

from torch import Tensor, nn

from eitskin.errors import InputError
from eitskin.learn.networks import HIDDEN, Shape
from eitskin.learn.networks.mlp import Mlp
from eitskin.learn.networks.teachers import Autoencoder


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


def autoencoder_mlp(shape: Shape) -> AutoencoderMlp:
    """The MLP on latent voltages. Raises InputError without an autoencoder."""
    if shape.latent_dim is None:
        raise InputError(shape.dataset, "autoencoder", "none", "one, whose encoder the model takes")
    return AutoencoderMlp(shape.n_channels, shape.n_targets, shape.latent_dim, shape.widths)

"""The networks that teach the physics-informed ones: an autoencoder, and its latent of a state."""

from torch import Tensor, nn

from eitskin.learn.networks import layers


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

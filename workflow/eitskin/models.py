"""Networks from voltages to contact states, and the files that hold them once trained."""

import io
import json
import zipfile
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from pickle import UnpicklingError

import torch
from torch import Tensor, nn

from eitskin.atomic import atomic_path
from eitskin.errors import InputError


def layers(*widths: int) -> nn.Sequential:
    """Linear layers of these widths with a ReLU between any two."""
    steps: list[nn.Module] = []
    for k, (wide, next_wide) in enumerate(pairwise(widths)):
        steps += [nn.ReLU()] * (k > 0) + [nn.Linear(wide, next_wide)]
    return nn.Sequential(*steps)


class Mlp(nn.Module):
    """f_θ: voltages (B, M) → states (B, T), hidden 256, 128, 64 (§ III-C)."""

    def __init__(self, n_channels: int, n_targets: int):
        super().__init__()
        self.net = layers(n_channels, 256, 128, 64, n_targets)

    def forward(self, voltage: Tensor) -> Tensor:
        return self.net(voltage)


class Autoencoder(nn.Module):
    """E_v, D_v: voltages (B, M) → latent (B, K) → voltages, hidden 256, 64 each way (§ III-C)."""

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


PREDICTORS = {"mlp": Mlp}  # each takes (n_channels, n_targets)
PHYSICS_INFORMED = "physics-informed-"  # before any predictor's name: trained by equation 8


def predictor(name: str, n_channels: int, n_targets: int) -> nn.Module:
    """A fresh predictor by its row's name in the table; raises InputError for an unknown name."""
    base = name.removeprefix(PHYSICS_INFORMED)
    if base not in PREDICTORS:
        known = [prefix + known for known in PREDICTORS for prefix in ("", PHYSICS_INFORMED)]
        raise InputError("models", "name", repr(name), f"one of {', '.join(known)}")
    return PREDICTORS[base](n_channels, n_targets)


@dataclass
class Trained:
    """A model file: `header` (plain JSON) and `tensors`, a seed's weights under `<seed>/`."""

    header: dict
    tensors: dict[str, Tensor]

    def seeds(self) -> list[int]:
        """The seeds it was trained with."""
        return [run["seed"] for run in self.header["runs"]]

    def into(self, module: nn.Module, seed: int) -> nn.Module:
        """`module` with this seed's weights, frozen."""
        start = f"{seed}/"
        weights = {k.removeprefix(start): v for k, v in self.tensors.items() if k.startswith(start)}
        module.load_state_dict(weights)
        return module.eval().requires_grad_(False)


def write(trained: Trained, path: str | Path) -> None:
    """Write a model file, atomically; equal contents give equal bytes, whatever the path."""
    content = {
        "header": json.dumps(trained.header, sort_keys=True, allow_nan=False),
        "tensors": {key: tensor.cpu().clone() for key, tensor in trained.tensors.items()},
    }
    buffer = io.BytesIO()  # to a path, torch.save would write the file's name into the archive
    torch.save(content, buffer)
    with atomic_path(path) as temporary:
        temporary.write_bytes(buffer.getvalue())


def read(path: str | Path) -> Trained:
    """Read a model file; raises InputError."""
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
        return Trained(json.loads(content["header"]), content["tensors"])
    except (OSError, RuntimeError, UnpicklingError, zipfile.BadZipFile, EOFError) as error:
        found = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(path, "file", found, "a model file") from None
    except (KeyError, TypeError):
        raise InputError(path, "file", "another PyTorch file", "a model file") from None

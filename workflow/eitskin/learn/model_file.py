"""The files that hold networks and support vectors once trained, a file for all seeds."""

import io
import json
import zipfile
from dataclasses import dataclass
from pathlib import Path
from pickle import UnpicklingError

import torch
from torch import Tensor, nn

from eitskin.atomic import atomic_path
from eitskin.errors import InputError


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

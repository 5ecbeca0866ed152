"""The files that hold networks and support vectors once trained, a file a seed."""

import io
import json
import zipfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from pickle import UnpicklingError
from typing import TypeVar

import torch
from torch import Tensor, nn

from eitskin.atomic import atomic_path
from eitskin.errors import InputError

Network = TypeVar("Network", bound=nn.Module)


@dataclass
class Trained:
    """A model file: `header` (plain JSON) and `tensors`, a seed's weights under `<seed>/`."""

    header: dict
    tensors: dict[str, Tensor]

    def seeds(self) -> list[int]:
        """The seeds it was trained with."""
        return [run["seed"] for run in self.header["runs"]]

    def into(self, module: Network, seed: int) -> Network:
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


def read_seeds(paths: Iterable[str | Path]) -> Trained:
    """Files of one model, a seed each, as one with all seeds; raises InputError, also for files of
    different trainings."""
    paths = list(paths)
    found = [read(path) for path in paths]
    header, scalers = _shared(found[0])
    for path, other in zip(paths, found, strict=True):
        own, scaled = _shared(other)
        alike = own == header and scaled.keys() == scalers.keys()
        if not alike or any(not torch.equal(scaled[key], scalers[key]) for key in scalers):
            raise InputError(path, "file", "another training", f"a seed of {paths[0]}'s")
    runs = [run for one in found for run in one.header["runs"]]
    tensors = {key: value for one in found for key, value in one.tensors.items()}
    return Trained({**found[0].header, "runs": runs}, tensors)


def _shared(trained: Trained) -> tuple[dict, dict[str, Tensor]]:
    """What all seeds of a training have alike: header and scalers."""
    header = {key: value for key, value in trained.header.items() if key != "runs"}
    return header, {key: value for key, value in trained.tensors.items() if "/" not in key}


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

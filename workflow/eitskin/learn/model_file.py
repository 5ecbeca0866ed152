"""The files of trained networks and support vectors, one for each seed."""

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
    """The content of a model file: `header`, values of JSON, and `tensors`, with a seed's weights
    under `<seed>/`."""

    header: dict
    tensors: dict[str, Tensor]

    def seeds(self) -> list[int]:
        """The seeds of the trainings."""
        return [run["seed"] for run in self.header["runs"]]

    def load_into(self, module: Network, seed: int) -> Network:
        """`module` with this seed's weights, frozen."""
        prefix = f"{seed}/"
        weights = {
            key.removeprefix(prefix): weight
            for key, weight in self.tensors.items()
            if key.startswith(prefix)
        }
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
    """The files of one model, a seed each, as one with all seeds; raises InputError, also for files
    of different trainings."""
    paths = list(paths)
    models = [read(path) for path in paths]
    header, scalers = _shared(models[0])
    for path, model in zip(paths, models, strict=True):
        other_header, other_scalers = _shared(model)
        same_training = other_header == header and other_scalers.keys() == scalers.keys()
        if not same_training or any(
            not torch.equal(other_scalers[key], scalers[key]) for key in scalers
        ):
            raise InputError(path, "file", "another training", f"a seed of {paths[0]}'s")
    runs = [run for model in models for run in model.header["runs"]]
    tensors = {key: value for model in models for key, value in model.tensors.items()}
    return Trained({**models[0].header, "runs": runs}, tensors)


def _shared(trained: Trained) -> tuple[dict, dict[str, Tensor]]:
    """The header and the scalers, which are equal for all seeds of a training."""
    header = {key: value for key, value in trained.header.items() if key != "runs"}
    return header, {key: value for key, value in trained.tensors.items() if "/" not in key}


def read(path: str | Path) -> Trained:
    """Read a model file; raises InputError."""
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
        return Trained(json.loads(content["header"]), content["tensors"])
    except (OSError, RuntimeError, UnpicklingError, zipfile.BadZipFile, EOFError) as error:
        message = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(path, "file", message, "a model file") from None
    except (KeyError, TypeError):
        raise InputError(path, "file", "another PyTorch file", "a model file") from None

"""The truth of a case, as it lies there once the block is opened."""

import json
from pathlib import Path

import numpy as np

from eitskin.errors import InputError


def cases(folder: Path) -> list[str]:
    """The names of all opened cases, in order; InputError where there is none."""
    found = sorted(path.stem for path in folder.glob("case-*.json"))
    if not found:
        raise InputError(folder, "folder", "no opened case", "case-*.json, as `open` writes them")
    return found


def read(folder: Path, case: str) -> tuple[dict, dict[str, np.ndarray]]:
    """A case's truth, and its arrays: noise_V (M,) and, of a simulated case, clean_V (N, M) and
    query_clean_V (Q, M)."""
    truth = json.loads((folder / f"{case}.json").read_text("utf-8"))
    with np.load(folder / f"{case}.npz", allow_pickle=False) as file:
        return truth, {name: file[name] for name in file.files}

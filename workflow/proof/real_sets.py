"""Where other laboratories' recordings lie, of which some cases are made."""

import os
import string
import warnings
from collections.abc import Container
from pathlib import Path

import numpy as np
import pandas as pd
import yaml

REAL = Path(__file__).parents[1] / "config" / "real.yaml"


def listed() -> dict[str, Path]:
    """The sets of workflow/config/real.yaml, below the environment's EITSKIN_DATA, there or not."""
    sets = yaml.safe_load(REAL.read_text("utf-8"))["recordings"]
    return {
        name: Path(string.Template(item["path"]).safe_substitute(os.environ))
        for name, item in sets.items()
    }


def present(names: Container[str] | None = None) -> dict[str, Path]:
    """Those of the `listed` sets, or of these names, that are there; a warning for each that is
    not."""
    paths = {}
    for name, path in listed().items():
        if names is not None and name not in names:
            continue
        if path.exists():
            paths[name] = path
        else:
            message = f"SKIPPED: no real recording {name} at {path}; set EITSKIN_DATA"
            warnings.warn(message, stacklevel=2)
    return paths


def renumbered(frames: pd.DataFrame, start_s: float) -> pd.DataFrame:
    """Some frames of a recording as a recording of their own: numbered from 0, with times after
    start_s."""
    frames = frames.reset_index(drop=True)
    number = np.arange(len(frames), dtype=np.int64)
    return frames.assign(frame=number, time_s=frames["time_s"] - start_s)

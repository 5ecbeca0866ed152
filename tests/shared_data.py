"""Where tests find real recordings that are not part of the project."""

import os
import warnings
from pathlib import Path

import pytest

ROOT = Path(os.environ.get("EITSKIN_DATA", Path(__file__).parents[2] / "shared" / "data"))


def shared_data(name: str) -> Path:
    """Path of `name` below the data folder; skips the calling test, loudly, where it is absent."""
    path = ROOT / name
    if not path.exists():
        warnings.warn(f"SKIPPED: no real recordings at {path}; set EITSKIN_DATA", stacklevel=2)
        pytest.skip(f"real recording absent: {path}")
    return path

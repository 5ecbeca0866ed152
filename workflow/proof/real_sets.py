"""Where other laboratories' recordings lie, of which some cases are made."""

import os
import string
from pathlib import Path

import yaml

REAL = Path(__file__).parents[1] / "config" / "real.yaml"


def listed() -> dict[str, Path]:
    """The sets of workflow/config/real.yaml, below the environment's EITSKIN_DATA, there or not."""
    sets = yaml.safe_load(REAL.read_text("utf-8"))["recordings"]
    return {
        name: Path(string.Template(item["path"]).safe_substitute(os.environ))
        for name, item in sets.items()
    }

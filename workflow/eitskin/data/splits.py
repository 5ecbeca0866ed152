"""Training, validation and test parts, by random frame, whole place or whole session."""

from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from eitskin.atomic import atomic_path
from eitskin.data import parquet
from eitskin.errors import InputError

GROUPS = {"random": "sample", "place": "place", "session": "session", "continuous": "session"}
PARTS = ("train", "validation", "test")
SHARE = 0.2  # of the test part, and of the remaining samples for validation (§ III-A)


def assign(table: pd.DataFrame, kind: str, seed: int) -> np.ndarray:
    """The part (N,) of each row of a data set's table: "train", "validation" or "test".

    Groups (frames, places or sessions) are drawn in random order and never split: the test part is
    as near to SHARE of the samples as possible, the validation part to SHARE of the remaining ones.
    "continuous" groups by session and demands that every sample has its own place. Raises
    InputError for an unknown kind, for repeated places where the kind is "continuous", and for
    fewer than three groups.
    """
    if kind not in GROUPS:
        raise InputError("split", "kind", repr(kind), f"one of {', '.join(GROUPS)}")
    if kind == "continuous" and not table["place"].is_unique:
        expected = "each sample its own, as in a set that ends in -continuous"
        raise InputError("split", "column place", "places pressed again", expected)
    _, group = np.unique(table[GROUPS[kind]].to_numpy(), return_inverse=True)
    size = np.bincount(group)
    if len(size) < 3:
        place = f"column {GROUPS[kind]}"
        raise InputError("split", place, f"{len(size)} group(s)", "at least 3, one for each part")
    drawn = np.random.default_rng(seed).permutation(len(size))
    n_test = _nearest(size[drawn], min_remaining=2)
    n_validation = _nearest(size[drawn[n_test:]], min_remaining=1)
    part = np.full(len(size), "train", dtype="<U10")
    part[drawn[:n_test]] = "test"
    part[drawn[n_test : n_test + n_validation]] = "validation"
    return part[group]


def _nearest(size: np.ndarray, min_remaining: int) -> int:
    """Number of leading groups whose samples come nearest to SHARE of all.

    At least `min_remaining` groups remain.
    """
    cumulative_size = np.cumsum(size)[: len(size) - min_remaining]
    return int(np.abs(cumulative_size - SHARE * size.sum()).argmin()) + 1


def write(path: str | Path, table: pd.DataFrame, part: np.ndarray) -> None:
    """Write columns `sample` and `part` to `path`, atomically; equal splits give equal bytes."""
    columns = pa.table({"sample": pa.array(table["sample"]), "part": pa.array(part.tolist())})
    with atomic_path(path) as temporary:
        pq.write_table(columns, temporary)


def read(path: str | Path, table: pd.DataFrame) -> np.ndarray:
    """The part (N,) of each row of `table`; raises InputError unless the file belongs to it."""
    split = parquet.frame(parquet.read(path))
    if list(split.columns) != ["sample", "part"]:
        raise InputError(path, "columns", list(split.columns), "['sample', 'part']")
    if not np.array_equal(split["sample"], table["sample"]):
        raise InputError(path, "column sample", "other samples", "those of the dataset")
    part = split["part"].to_numpy(dtype="<U10")
    if not np.isin(part, PARTS).all():
        raise InputError(path, "column part", sorted(set(part)), f"{', '.join(PARTS)}")
    return part

"""What estimates are worth without an electrode or two: `python -m studies.lost_electrodes EXPORT
DATASET SPLIT`.

Of touches of the test part, every electrode's channels are taken away in turn, then those of PAIRS
drawn pairs. A line each: the root mean squared error of the force, that of the place and its
median, beside those with all channels, and the share of the truth that the intervals hold.
"""

import argparse
import sys
from itertools import combinations

import numpy as np
import pandas as pd

from eitskin.data import dataset, splits
from eitskin.exported.channels import strength
from eitskin.exported.electrodes import using
from eitskin.exported.predictor import Predictor, read

PAIRS, SEED = 30, 1


def errors(predictor: Predictor, change: np.ndarray, lost: tuple[int, ...]) -> tuple:
    """States (N, T) of changes (N, M) without electrodes, and half their intervals (N, T)."""
    table = np.array(predictor.header["dataset"]["channels"])
    gone = np.flatnonzero(using(table, lost))
    z = change / predictor.scale
    number = np.searchsorted(predictor.channels.edges, strength(np.delete(z, gone, axis=1)))
    if not lost:
        return predictor.states(change), predictor.half[number]
    whole = predictor.channels.filled_alike(z, gone) * predictor.scale
    half = np.array([predictor.half_of(int(one), lost) for one in number])
    return predictor.states_without(whole, lost), half


def table(predictor: Predictor, change: np.ndarray, truth: np.ndarray) -> pd.DataFrame:
    """A row without electrodes lost, one an electrode, one a drawn pair; states (N, T) in the order
    x, y, F."""
    count = 1 + int(np.max(predictor.header["dataset"]["channels"]))
    pairs = list(combinations(range(count), 2))
    drawn = np.random.default_rng(SEED).choice(len(pairs), min(PAIRS, len(pairs)), replace=False)
    sets = [(), *((k,) for k in range(count)), *(pairs[k] for k in np.sort(drawn))]
    rows = []
    for lost in sets:
        state, half = errors(predictor, change, lost)
        off = state - truth
        place = np.hypot(off[:, 0], off[:, 1])
        held = (np.abs(off) <= half).mean(axis=0)
        rows.append(
            {
                "lost": " ".join(map(str, lost)) or "none",
                "rmse_F_N": np.sqrt(np.mean(off[:, 2] ** 2)),
                "rmse_place_mm": np.sqrt(np.mean(place**2)),
                "median_place_mm": np.median(place),
                **{f"held_{name}": share for name, share in zip("xyF", held, strict=True)},
            }
        )
    return pd.DataFrame(rows)


def main() -> int:
    """Print the table as CSV; the exit code."""
    parser = argparse.ArgumentParser(prog="python -m studies.lost_electrodes", description=__doc__)
    for name in ("export", "dataset", "split"):
        parser.add_argument(name)
    given = parser.parse_args()
    data = dataset.read(given.dataset)
    tested = splits.read(given.split, data.table) == "test"
    predictor = read(given.export)
    change, truth = data.delta_V[tested].astype(float), data.states()[tested]
    table(predictor, change, truth).to_csv(sys.stdout, index=False, float_format="%.3f")
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""What estimates are worth without an electrode or two: `python -m studies.lost_electrodes EXPORT
DATASET SPLIT [--samples N]`, with `config.yaml` beside it.

Of N touches drawn from the test part, every electrode's channels are taken away in turn, then those
of PAIRS drawn pairs. A line each: the root mean squared error of the force, that of the place and
its median, beside those with all channels, and the share of the truth that the intervals hold. Of a
continuous set also the limit: the errors of the posterior mean of the channels that are left, of
the same touches, and how many times as large the estimate's are.
"""

import argparse
import sys
from dataclasses import replace
from itertools import combinations

import numpy as np
import pandas as pd

from eitskin import configuration
from eitskin.data import dataset, splits
from eitskin.exported.channels import strength
from eitskin.exported.electrodes import using
from eitskin.exported.predictor import Predictor, read
from eitskin.limit.observation import SessionModel
from eitskin.limit.posterior_mean import Starts, estimate, experiment_of
from eitskin.progress import patient

PAIRS, SEED = 30, 1
SAMPLES = 100  # of the test part
DRAWN = 32  # pairs of draws from each posterior


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


def limit(
    model: SessionModel, starts: Starts, change: np.ndarray, lost: tuple[int, ...]
) -> np.ndarray:
    """(N, 3): posterior means of x mm, y mm and F N given changes (N, M) without electrodes."""
    table = model.experiment.channels
    kept = np.setdiff1d(np.arange(len(table)), np.flatnonzero(using(table, lost)))
    model = replace(model, read=kept)
    found = []
    for k, own in enumerate(change):
        rng = np.random.default_rng([SEED, k])
        posterior = estimate(model, own[kept], starts.of(own, kept), DRAWN, rng)
        found.append(posterior["mean"])
    return np.array(found)


def table(
    predictor: Predictor, change: np.ndarray, truth: np.ndarray, model: SessionModel | None = None
) -> pd.DataFrame:
    """A row without electrodes lost, one an electrode, one a drawn pair; states (N, T) in the order
    x, y, F; model: whose posterior means are the limit, beside them."""
    count = 1 + int(np.max(predictor.header["dataset"]["channels"]))
    pairs = list(combinations(range(count), 2))
    drawn = np.random.default_rng(SEED).choice(len(pairs), min(PAIRS, len(pairs)), replace=False)
    sets = [(), *((k,) for k in range(count)), *(pairs[k] for k in np.sort(drawn))]
    rows = []
    starts = None if model is None else Starts(model)
    for lost in patient(sets, "sets of lost electrodes"):
        state, half = errors(predictor, change, lost)
        held = (np.abs(state - truth) <= half).mean(axis=0)
        sizes = _sizes(state - truth)
        row: dict = {"lost": " ".join(map(str, lost)) or "none", **sizes}
        row |= {f"held_{name}": share for name, share in zip("xyF", held, strict=True)}
        if model is not None and starts is not None:
            least = _sizes(limit(model, starts, change, lost) - truth)
            row |= {f"limit_{key}": value for key, value in least.items()}
            row |= {f"times_{key}": sizes[key] / value for key, value in least.items()}
        rows.append(row)
    return pd.DataFrame(rows)


def _sizes(off: np.ndarray) -> dict[str, float]:
    place = np.hypot(off[:, 0], off[:, 1])
    return {
        "rmse_F_N": float(np.sqrt(np.mean(off[:, 2] ** 2))),
        "rmse_place_mm": float(np.sqrt(np.mean(place**2))),
        "median_place_mm": float(np.median(place)),
    }


def model_of(data: dataset.Dataset, config: dict) -> SessionModel | None:
    """What a continuous set's sessions were drawn from; None of any other set."""
    name = data.metadata["name"].removeprefix("simulated-")
    one = configuration.with_continuous(config).get(name)
    if one is None or one["continuous"] is None:
        return None
    skin, effects = config["skin"], one["effects"]
    frames = one["session_frames"], one["continuous"]
    return experiment_of(data, skin, config["accuracy"], effects, *frames).unknown()


def main() -> int:
    """Print the table as CSV; the exit code."""
    parser = argparse.ArgumentParser(prog="python -m studies.lost_electrodes", description=__doc__)
    for name in ("export", "dataset", "split"):
        parser.add_argument(name)
    parser.add_argument("--samples", type=int, default=SAMPLES)
    given = parser.parse_args()
    data = dataset.read(given.dataset)
    tested = np.flatnonzero(splits.read(given.split, data.table) == "test")
    drawn = np.random.default_rng(SEED).choice(
        tested, min(given.samples, len(tested)), replace=False
    )
    tested = np.sort(drawn)
    predictor = read(given.export)
    change, truth = data.delta_V[tested].astype(float), data.states()[tested]
    model = model_of(data, configuration.read("config.yaml"))
    table(predictor, change, truth, model).to_csv(sys.stdout, index=False, float_format="%.3f")
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""What estimates are worth without an electrode or two: `python -m studies.lost_electrodes EXPORT
DATASET SPLIT [--samples N]`, with `config.yaml` beside it.

Every electrode's channels are taken away in turn, then those of PAIRS drawn pairs, each set's from
N touches of its own, drawn from the test part; with all channels there are as many as of all single
electrodes. A line each, and one of all single electrodes and of all pairs together: the root mean
squared error of the force, that of the place and its median, and the share of the truth that the
intervals hold. Of a continuous set also the limit: the errors of the posterior mean of the channels
that are left, of the same touches, how many times as large the estimate's are, and 95 % of that
over sessions.
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
from eitskin.exported.electrodes import channels_using
from eitskin.exported.predictor import Predictor, read
from eitskin.limit.observation import SessionModel
from eitskin.limit.posterior_mean import Starts, estimate, experiment_of
from eitskin.limit.score import resampled_sessions
from eitskin.progress import patient

PAIRS, SEED = 30, 1
SAMPLES = 20  # touches of a set
SIZES = ("none", "one", "two")
DRAWN = 32  # pairs of draws from each posterior


def errors(predictor: Predictor, change: np.ndarray, lost: tuple[int, ...]) -> tuple:
    """States (N, T) of changes (N, M) without electrodes, and half their intervals (N, T)."""
    table = np.array(predictor.header["dataset"]["channels"])
    gone = np.flatnonzero(channels_using(table, lost))
    z = change / predictor.scale
    number = np.searchsorted(predictor.channels.edges, strength(np.delete(z, gone, axis=1)))
    if not lost:
        return predictor.states(change), predictor.half[number]
    whole = predictor.channels.filled_together(z, gone) * predictor.scale
    half = np.array([predictor.half_of(int(one), lost) for one in number])
    return predictor.states_without(whole, lost), half


def limit(
    model: SessionModel, starts: Starts, change: np.ndarray, lost: tuple[int, ...]
) -> np.ndarray:
    """(N, 3): posterior means of x mm, y mm and F N given changes (N, M) without electrodes."""
    table = model.experiment.channels
    kept = np.setdiff1d(np.arange(len(table)), np.flatnonzero(channels_using(table, lost)))
    model = replace(model, read_channels=kept)
    found = []
    for k, own in enumerate(change):
        rng = np.random.default_rng([SEED, k])
        posterior = estimate(model, own[kept], starts.nearest(own, kept), DRAWN, rng)
        found.append(posterior["mean"])
    return np.array(found)


def sets_of(electrodes: int) -> list[tuple[int, ...]]:
    """No electrode, each alone, and PAIRS drawn pairs."""
    pairs = list(combinations(range(electrodes), 2))
    drawn = np.random.default_rng(SEED).choice(len(pairs), min(PAIRS, len(pairs)), replace=False)
    return [(), *((k,) for k in range(electrodes)), *(pairs[k] for k in np.sort(drawn))]


def rows_of(tested: np.ndarray, sets: list[tuple[int, ...]], samples: int) -> list[np.ndarray]:
    """Touches for every set, drawn of those `tested`: so many, with all channels as many as of all
    single electrodes together. No touch is drawn again before all have been."""
    singles = sum(len(lost) == 1 for lost in sets)
    counts = [samples if lost else samples * singles for lost in sets]
    order = np.resize(np.random.default_rng(SEED).permutation(tested), sum(counts))
    return [np.sort(own) for own in np.split(order, np.cumsum(counts)[:-1])]


def table(
    predictor: Predictor,
    change: np.ndarray,
    truth: np.ndarray,
    session: np.ndarray,
    sets: list[tuple[int, ...]],
    rows: list[np.ndarray],
    model: SessionModel | None = None,
) -> pd.DataFrame:
    """A row a set, of its touches `rows` among changes (N, M) and states (N, T), in the order x, y,
    F, of sessions (N,); then one of each size of set, all its touches together. model: whose
    posterior means are the limit, beside them."""
    starts = None if model is None else Starts(model)
    told: dict[str, list[tuple]] = {}
    for lost, own in zip(patient(sets, "sets of lost electrodes"), rows, strict=True):
        state, half = errors(predictor, change[own], lost)
        off, least = state - truth[own], None
        if model is not None and starts is not None:
            least = limit(model, starts, change[own], lost) - truth[own]
        found = off, np.abs(off) <= half, session[own], least
        told.setdefault(" ".join(map(str, lost)) or SIZES[0], []).append(found)
        if lost:
            told.setdefault(SIZES[len(lost)], []).append(found)
    together = [name for name in told if name in SIZES[1:]]
    order = [*(name for name in told if name not in together), *together]
    return pd.DataFrame([_row(name, told[name]) for name in order])


def _row(name: str, found: list[tuple]) -> dict:
    """Of one set, or of several together: errors, shares of the truth held, the limit's errors, how
    many times as large the estimate's are, and 95 % of that by a bootstrap over sessions."""
    off, held, session = (np.concatenate([one[k] for one in found]) for k in range(3))
    row: dict = {"lost": name, "touches": len(off), **_sizes(off)}
    row |= {f"held_{key}": share for key, share in zip("xyF", held.mean(axis=0), strict=True)}
    if any(one[3] is None for one in found):
        return row
    least = np.concatenate([one[3] for one in found])
    row |= {f"limit_{key}": value for key, value in _sizes(least).items()}
    again = resampled_sessions(pd.DataFrame({"session": session}), SEED)
    times = [_times(off[drawn], least[drawn]) for drawn in again]
    for key, value in _times(off, least).items():
        low, high = np.quantile([one[key] for one in times], [0.025, 0.975])
        row |= {f"times_{key}": value, f"times_{key}_low": low, f"times_{key}_high": high}
    return row


def _times(off: np.ndarray, least: np.ndarray) -> dict[str, float]:
    ours, theirs = _sizes(off), _sizes(least)
    return {key: ours[key] / theirs[key] for key in ours}


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
    return experiment_of(data, skin, config["accuracy"], effects, *frames).prior_session()


def main() -> int:
    """Print the table as CSV; the exit code."""
    parser = argparse.ArgumentParser(prog="python -m studies.lost_electrodes", description=__doc__)
    for name in ("export", "dataset", "split"):
        parser.add_argument(name)
    parser.add_argument("--samples", type=int, default=SAMPLES)
    given = parser.parse_args()
    data = dataset.read(given.dataset)
    tested = np.flatnonzero(splits.read(given.split, data.table) == "test")
    predictor = read(given.export)
    sets = sets_of(1 + int(np.max(predictor.header["dataset"]["channels"])))
    rows = rows_of(tested, sets, given.samples)
    model = model_of(data, configuration.read("config.yaml"))
    change, truth = data.delta_V.astype(float), data.states()
    session = data.table["session"].to_numpy()
    found = table(predictor, change, truth, session, sets, rows, model)
    found.to_csv(sys.stdout, index=False, float_format="%.3f")
    return 0


if __name__ == "__main__":
    sys.exit(main())

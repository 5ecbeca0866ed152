"""What estimates are worth without an electrode or two: `python -m benchmark.lost_electrodes EXPORT
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
from dataclasses import dataclass, replace
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
    missing = np.flatnonzero(channels_using(table, lost))
    z = change / predictor.scale
    number = np.searchsorted(predictor.channels.edges, strength(np.delete(z, missing, axis=1)))
    if not lost:
        return predictor.states(change), predictor.half[number]
    filled = predictor.channels.filled_together(z, missing) * predictor.scale
    half = np.array([predictor.half_of(int(index), lost) for index in number])
    return predictor.states_without(filled, lost), half


def limit(
    model: SessionModel, starts: Starts, change: np.ndarray, lost: tuple[int, ...]
) -> np.ndarray:
    """(N, 3): posterior means of x mm, y mm and F N given changes (N, M) without electrodes."""
    table = model.experiment.channels
    channels = np.setdiff1d(np.arange(len(table)), np.flatnonzero(channels_using(table, lost)))
    model = replace(model, read_channels=channels)
    means = []
    for k, touch in enumerate(change):
        rng = np.random.default_rng([SEED, k])
        posterior = estimate(model, touch[channels], starts.nearest(touch, channels), DRAWN, rng)
        means.append(posterior["mean"])
    return np.array(means)


def sets_of(electrodes: int) -> list[tuple[int, ...]]:
    """No electrode, each alone, and PAIRS drawn pairs."""
    pairs = list(combinations(range(electrodes), 2))
    index = np.random.default_rng(SEED).choice(len(pairs), min(PAIRS, len(pairs)), replace=False)
    return [(), *((k,) for k in range(electrodes)), *(pairs[k] for k in np.sort(index))]


def rows_of(tested: np.ndarray, sets: list[tuple[int, ...]], samples: int) -> list[np.ndarray]:
    """Touches for every set, drawn of those `tested`: so many, with all channels as many as of all
    single electrodes together. No touch is drawn again before all have been."""
    singles = sum(len(lost) == 1 for lost in sets)
    counts = [samples if lost else samples * singles for lost in sets]
    order = np.resize(np.random.default_rng(SEED).permutation(tested), sum(counts))
    return [np.sort(members) for members in np.split(order, np.cumsum(counts)[:-1])]


@dataclass(frozen=True)
class Touches:
    """Touches of a dataset: changes (N, M) in V, states (N, T) in the order x, y, F, and sessions
    (N,)."""

    change: np.ndarray
    truth: np.ndarray
    session: np.ndarray

    def part(self, index: np.ndarray) -> "Touches":
        """Some of the touches."""
        return Touches(self.change[index], self.truth[index], self.session[index])


def table(
    predictor: Predictor,
    touches: Touches,
    sets: list[tuple[int, ...]],
    rows: list[np.ndarray],
    model: SessionModel | None = None,
) -> pd.DataFrame:
    """A row a set, of its touches `rows`; then one of each size of set, all its touches together.
    model: whose posterior means are the limit, beside them."""
    starts = None if model is None else Starts(model)
    parts: dict[str, list[tuple]] = {}
    for lost, index in zip(patient(sets, "sets of lost electrodes"), rows, strict=True):
        part = touches.part(index)
        state, half = errors(predictor, part.change, lost)
        error, limit_error = state - part.truth, None
        if model is not None and starts is not None:
            limit_error = limit(model, starts, part.change, lost) - part.truth
        outcome = error, np.abs(error) <= half, part.session, limit_error
        parts.setdefault(" ".join(map(str, lost)) or SIZES[0], []).append(outcome)
        if lost:
            parts.setdefault(SIZES[len(lost)], []).append(outcome)
    together = [name for name in parts if name in SIZES[1:]]
    order = [*(name for name in parts if name not in together), *together]
    return pd.DataFrame([_row(name, parts[name]) for name in order])


def _row(name: str, parts: list[tuple]) -> dict:
    """Of one set, or of several together: errors, shares of the truth held, the limit's errors, how
    many times as large the estimate's are, and 95 % of that by a bootstrap over sessions."""
    error, inside, session = (np.concatenate([part[k] for part in parts]) for k in range(3))
    row: dict = {"lost": name, "touches": len(error), **_sizes(error)}
    row |= {f"held_{key}": share for key, share in zip("xyF", inside.mean(axis=0), strict=True)}
    if any(part[3] is None for part in parts):
        return row
    limit_error = np.concatenate([part[3] for part in parts])
    row |= {f"limit_{key}": value for key, value in _sizes(limit_error).items()}
    resamples = resampled_sessions(pd.DataFrame({"session": session}), SEED)
    times = [_times(error[index], limit_error[index]) for index in resamples]
    for key, value in _times(error, limit_error).items():
        low, high = np.quantile([part[key] for part in times], [0.025, 0.975])
        row |= {f"times_{key}": value, f"times_{key}_low": low, f"times_{key}_high": high}
    return row


def _times(error: np.ndarray, limit_error: np.ndarray) -> dict[str, float]:
    ours, theirs = _sizes(error), _sizes(limit_error)
    return {key: ours[key] / theirs[key] for key in ours}


def _sizes(error: np.ndarray) -> dict[str, float]:
    place = np.hypot(error[:, 0], error[:, 1])
    return {
        "rmse_F_N": float(np.sqrt(np.mean(error[:, 2] ** 2))),
        "rmse_place_mm": float(np.sqrt(np.mean(place**2))),
        "median_place_mm": float(np.median(place)),
    }


def model_of(data: dataset.Dataset, config: dict) -> SessionModel | None:
    """What a continuous set's sessions were drawn from; None of any other set."""
    name = data.metadata["name"].removeprefix("simulated-")
    entry = configuration.with_continuous(config).get(name)
    if entry is None or entry["continuous"] is None:
        return None
    skin, effects = config["skin"], entry["effects"]
    frames = entry["session_frames"], entry["continuous"]
    return experiment_of(data, skin, config["accuracy"], effects, *frames).prior_session()


def main() -> int:
    """Print the table as CSV; the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmark.lost_electrodes", description=__doc__
    )
    for name in ("export", "dataset", "split"):
        parser.add_argument(name)
    parser.add_argument("--samples", type=int, default=SAMPLES)
    arguments = parser.parse_args()
    data = dataset.read(arguments.dataset)
    tested = np.flatnonzero(splits.read(arguments.split, data.table) == "test")
    predictor = read(arguments.export)
    sets = sets_of(1 + int(np.max(predictor.header["dataset"]["channels"])))
    rows = rows_of(tested, sets, arguments.samples)
    model = model_of(data, configuration.read("config.yaml"))
    session = data.table["session"].to_numpy()
    touches = Touches(data.delta_V.astype(float), data.states(), session)
    lines = table(predictor, touches, sets, rows, model)
    lines.to_csv(sys.stdout, index=False, float_format="%.3f")
    return 0


if __name__ == "__main__":
    sys.exit(main())

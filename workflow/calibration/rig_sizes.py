"""`python -m calibration.rig_sizes results/rig_sizes 301 420` measures how well sizes of rig errors
are learned, a kind a recording, without the search.

Ten or so presses are a chance of their own: the size of the drawn errors, `true`, is their root
mean square over what the diagnosis was shown. It can be told where noise leaves the logarithm of a
size uncertain by less than half of that of WITHIN, by the expected information at the true size.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from calibration.intervals import rms, wilson
from eitskin.atomic import atomic_path
from eitskin.diagnose import diagnosis
from eitskin.diagnose.fitting.estimates import NORMAL_90
from eitskin.diagnose.noise.estimate import Noise
from eitskin.diagnose.noise.rig import COMPONENTS, SLOW_WALKS, WALKS
from eitskin.diagnose.noise.rig_sizes import findings
from eitskin.diagnose.search.state import State
from witness import cases, rig_errors
from witness.rig_errors import USUAL, RigError

WITHIN = 1.5  # a factor, by which a size may be off
TOLD = 0.5 * np.log(WITHIN)  # sd of a size's logarithm
DRAWS = 20  # of the noise, for what rounding does to it
STANDS_OUT = 8.0  # sd of the noise, from which a spike, or a frame, is to be found
PATHS = {  # sine waves of a walk
    "gain-walk": WALKS,
    "force-zero-walk": SLOW_WALKS,
    "channel-drift": SLOW_WALKS,
}
OF_NOISE = ("correlated-noise", "uneven-noise", "loud-frames", "spikes")
KINDS = tuple(kind for kind in USUAL if kind in COMPONENTS or kind in OF_NOISE)
ROW = ("kind", "drawn", "true", "found", "low", "high", "log_sd", "told", "within")
TABLE = ("rig_error", "n", "told", "within", "within_low", "within_high", "ratio")


def compared(case: cases.Case, seen: np.ndarray, noise: Noise, state: State) -> list[dict]:
    """One row (ROW) for each of a case's rig errors that has a size to be learned; seen (N, M):
    readings that were shown.

    drawn: size as the witness drew it, in V, mm, N or 1; noise correlated in time by the frames
    after which 1/e is left, loud frames and spikes as a share of all. low, high: the found size's
    90 % interval, NaN where it has none. log_sd: how uncertain noise leaves the logarithm of it.
    """
    assert state.rig is not None
    components = findings(state.rig, state.sizes, state.fit.misfit, case.metadata["unit"])
    said = {one["name"]: one for one in components}
    rows = []
    for error in case.rig:
        if error.kind in COMPONENTS:
            true, drawn = _true(case, error, seen), error.size * _unit(case, error)
            one = said.get(error.kind, {"sd": 0.0, "low": 0.0, "high": 0.0})
            told = one["sd"], one["low"], one["high"]
            log_sd = _log_sd(state, error.kind, true)
        elif error.kind in OF_NOISE:
            drawn, true, found, log_sd = map(float, _of_noise(case, error, noise))
            told = found, np.nan, np.nan
        else:
            continue
        right = bool(true > 0.0 and 1.0 / WITHIN < told[0] / true < WITHIN)
        values = (error.kind, drawn, true, *told, log_sd, bool(log_sd < TOLD), right)
        rows.append(dict(zip(ROW, values, strict=True)))
    return rows


def _unit(case: cases.Case, error: RigError) -> float:
    """What a size is told over."""
    of_median = USUAL[error.kind].unit == "median |v|"
    return float(np.median(np.abs(case.clean[0]))) if of_median else 1.0


def _log_sd(state: State, kind: str, true: float) -> float:
    """How uncertain the logarithm of a size is, at its true value, beside what the few errors that
    were drawn leave open; infinite where the recording has no such error."""
    rig = state.rig
    assert rig is not None
    if kind not in rig.columns or true == 0.0:
        return np.inf
    size = true**2 / np.sqrt(2.0) if kind == "quadrature" else true
    sizes = {**state.sizes, kind: size}
    found = findings(rig, sizes, state.fit.misfit, "V")
    (one,) = (one for one in found if one["name"] == kind)
    whole = np.log(one["high"] / one["low"]) / (2.0 * NORMAL_90)
    columns, each = rig.columns[kind], COMPONENTS[kind].each
    there = np.asarray(columns.any(axis=0))
    count = {
        "whole": 1,
        "channel": there.any(axis=0).sum(),
        "frame": there.any(axis=1).sum(),
        "press": (rig.of_press @ there.any(axis=1) > 0.0).sum(),
    }[each]
    chance = 0.5 / (len(columns) * count)
    if kind == "quadrature":
        chance *= 0.25
    return float(np.sqrt(max(whole**2 - chance, 0.0))) if one["learned"] else np.inf


def _true(case: cases.Case, error: RigError, seen: np.ndarray) -> float:
    """Root mean square of the errors that were drawn, over what was seen."""
    frames = np.asarray(seen.any(axis=1))
    if USUAL[error.kind].target == "states":
        return _of_states(case, error, frames)
    if error.kind == "quantisation":
        return _rounded(case, error, frames)
    silent = np.zeros_like(case.noise_V)
    rng = np.random.default_rng(0)
    made = rig_errors.read(case.clean, [error], case.true_states, silent, rng)
    if error.kind in ("amplitude-per-frame", "gain-walk"):
        largest = [int(np.argmax(np.abs(case.clean[0])))]
        off = made[:, largest] / case.clean[:, largest] - 1.0
    elif error.kind == "quadrature":
        read = case.clean[0] != 0.0  # an open electrode leaves channels without any
        square = (made[0, read] / case.clean[0, read]) ** 2
        return rms(np.sqrt(np.maximum(square - 1.0, 0.0)))
    else:
        off = made - case.clean
    if error.kind in PATHS:
        every = np.ones(len(frames), bool)
        return rms(_waves(case.true_states, off, every, PATHS[error.kind]))
    return rms(off[frames])


def _of_states(case: cases.Case, error: RigError, frames: np.ndarray) -> float:
    kind, reported = error.kind, rig_errors.reported(case.true_states, [error])
    touched = case.true_states["touch"].to_numpy(bool)
    # Gaps in a path leave its waves open: it counts as a whole.
    frames = touched if kind in PATHS else frames & touched
    told, true = reported[frames], case.true_states[frames]
    keys = ["x_mm", "y_mm"] if kind.startswith("place") else ["force_N"]
    off = told[keys] - true[keys]
    if kind == "force-per-press":
        off = off / true[keys]
    if kind.endswith("per-press"):
        off = off.groupby(true["contact"]).median()
    if kind in PATHS:
        every = np.zeros((len(case.states), 1))
        every[frames] = off
        return rms(_waves(case.true_states, every, frames, PATHS[kind]))
    return rms(off.to_numpy(float))


def _waves(states: pd.DataFrame, path: np.ndarray, frames: np.ndarray, count: int) -> np.ndarray:
    """(count, K): paths (N, K) in the first sine waves of a random walk of sd 1 at its end, by some
    frames' least squares."""
    time = states["time_s"].to_numpy(float)
    share = (time - time[0]) / np.ptp(time)
    rate = np.pi * (np.arange(count) + 0.5)
    waves = np.sqrt(2.0) * np.sin(np.outer(share, rate)) / rate
    return np.linalg.lstsq(waves[frames], path[frames])[0]


def _rounded(case: cases.Case, error: RigError, frames: np.ndarray) -> float:
    """Of what rounding does to a reading at rest, what noise does not scatter away."""
    still = frames & ~case.true_states["touch"].to_numpy(bool)
    finer = [one for one in case.rig if one is not error]
    off = []
    for draw in range(DRAWS):
        rounded, whole = (_read(case, errors, draw)[still] for errors in (case.rig, finer))
        off.append(np.nanmean(rounded - whole, axis=0))
    return rms(np.mean(off, axis=0))


def _of_noise(case: cases.Case, error: RigError, noise: Noise) -> tuple[float, float, float, float]:
    """(drawn, true, found, log_sd) of a property of the noise itself."""
    frames, channels = case.clean.shape
    if error.kind == "correlated-noise":
        rho, found = error.size, noise.correlation
        lasts = -1.0 / np.log(rho)
        log_sd = lasts / rho * noise.correlation_sd(rho)
        return lasts, lasts, -1.0 / np.log(found) if found else 0.0, log_sd
    if error.kind == "uneven-noise":
        size, found = error.size, np.std(np.log(noise.sd / case.noise_V))
        log_sd = (1.0 + 0.5 / (frames * size**2)) / np.sqrt(2.0 * channels)
        return size, size, found, log_sd
    height = np.abs(_read(case, [error], 0) - _read(case, [], 0)) / case.noise_V
    if error.kind == "loud-frames":
        true, found = (np.median(height, axis=1) > 0.0).mean(), len(noise.loud_frames) / frames
    else:
        true, found = (height > STANDS_OUT).mean(), noise.spikes / height.size
    return error.size, true, found, 0.0 if true else np.inf


def _read(case: cases.Case, errors: Sequence[RigError], seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rig_errors.read(case.clean, errors, case.true_states, case.noise_V, rng)


def table(rows: list[dict]) -> pd.DataFrame:
    """Rows (ROW) counted, one row (TABLE) a kind and one for all: n, those that can be told, and of
    these how many are within WITHIN, with the share's interval, and the median of found over true.
    """
    of = pd.DataFrame(rows, columns=list(ROW))
    made = []
    for kind in ("any", *sorted(of["kind"].unique())):
        own = of if kind == "any" else of[of["kind"] == kind]
        told = own[own["told"].astype(bool)]
        hits = int(told["within"].sum())
        low, high = wilson(hits, len(told))
        ratio = (told["found"] / told["true"]).median()
        values = (kind, len(own), len(told), hits, low, high, ratio)
        made.append(dict(zip(TABLE, values, strict=True)))
    return pd.DataFrame(made, columns=list(TABLE))


def measured(kind: str, seed: int) -> list[dict]:
    """`compared`, and its seed, of a recording in which nothing is wrong but one kind of error."""
    case = cases.draw(f"null+rig:{kind}", seed)
    recorded = case.recorded
    noise, search, _ = diagnosis.begun(recorded, 1)
    state = search.calibrated()
    rows = compared(case, search.problem.whitening.mask, noise, state)
    return [{"seed": seed, **row} for row in rows]


def write(folder: Path, first: int, last: int) -> None:
    """rows.csv and rig_sizes.csv of the seeds from first to last, every kind in turn, into a
    folder."""
    plan = [(KINDS[seed % len(KINDS)], seed) for seed in range(first, last + 1)]
    rows = [row for one in plan for row in measured(*one)]
    folder.mkdir(parents=True, exist_ok=True)
    for name, made in {"rows": pd.DataFrame(rows), "rig_sizes": table(rows)}.items():
        with atomic_path(folder / f"{name}.csv") as path:
            made.to_csv(path, index=False)


if __name__ == "__main__":
    write(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))

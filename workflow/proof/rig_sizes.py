"""`python -m proof.rig_sizes results/rig_sizes 301 420` measures how well sizes of rig errors
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

from eitskin.atomic import atomic_path
from eitskin.diagnose.noise.component_sds import component_intervals
from eitskin.diagnose.noise.components import COMPONENTS, FAST_WAVES, SLOW_WAVES
from eitskin.diagnose.noise.noise_model import NORMAL_90, NoiseModel
from eitskin.diagnose.search.explanation import Explanation
from proof.intervals import rms, wilson
from proof.refit import calibrated
from witness import cases, rig_errors
from witness.rig_errors import USUAL, RigError

WITHIN = 1.5  # a factor, by which a size may be off
TELLABLE_SD = 0.5 * np.log(WITHIN)  # sd of a size's logarithm, from which it can be told
DRAWS = 20  # of the noise, for what rounding does to it
STANDS_OUT = 8.0  # sd of the noise, from which a spike, or a frame, is to be found
PATHS = {  # sine waves of a walk
    "gain-walk": FAST_WAVES,
    "force-zero-walk": SLOW_WAVES,
    "channel-drift": SLOW_WAVES,
}
OF_NOISE = ("correlated-noise", "uneven-noise", "loud-frames", "spikes")
KINDS = tuple(kind for kind in USUAL if kind in COMPONENTS or kind in OF_NOISE)
ROW = ("kind", "drawn", "true", "found", "low", "high", "log_sd", "told", "within")
TABLE = ("rig_error", "n", "told", "within", "within_low", "within_high", "ratio")


def compared(
    case: cases.Case, seen_mask: np.ndarray, noise: NoiseModel, state: Explanation
) -> list[dict]:
    """One row (ROW) for each of a case's rig errors that has a size to be learned; seen_mask
    (N, M): readings that were shown.

    drawn: size as the witness drew it, in V, mm, N or 1; noise correlated in time by the frames
    after which 1/e is left, loud frames and spikes as a share of all. low, high: the found size's
    90 % interval, NaN where it has none. log_sd: how uncertain noise leaves the logarithm of it.
    """
    assert state.rig is not None
    components = component_intervals(state.rig, state.error_sds, case.metadata["unit"])
    component_of = {component["name"]: component for component in components}
    rows = []
    for error in case.rig:
        if error.kind not in USUAL:  # in a form that has no size to be learned
            continue
        if error.kind in COMPONENTS:
            true, drawn_size = _true(case, error, seen_mask), error.size * _unit(case, error)
            component = component_of.get(error.kind, {"sd": 0.0, "low": 0.0, "high": 0.0})
            learned = component["sd"], component["low"], component["high"]
            log_sd = _log_sd(state, error.kind, true)
        elif error.kind in OF_NOISE:
            drawn_size, true, estimate, log_sd = map(float, _of_noise(case, error, noise))
            learned = estimate, np.nan, np.nan
        else:
            continue
        within = bool(true > 0.0 and 1.0 / WITHIN < learned[0] / true < WITHIN)
        tellable = bool(log_sd < TELLABLE_SD)
        values = (error.kind, drawn_size, true, *learned, log_sd, tellable, within)
        rows.append(dict(zip(ROW, values, strict=True)))
    return rows


def _unit(case: cases.Case, error: RigError) -> float:
    """What a size is told over."""
    of_median = USUAL[error.kind].unit == "median |v|"
    return float(np.median(np.abs(case.clean[0]))) if of_median else 1.0


def _log_sd(state: Explanation, kind: str, true: float) -> float:
    """How uncertain the logarithm of a size is, at its true value, beside what the few errors that
    were drawn leave open; infinite where the recording has no such error."""
    rig = state.rig
    assert rig is not None
    if kind not in rig.columns or true == 0.0:
        return np.inf
    size = true**2 / np.sqrt(2.0) if kind == "quadrature" else true
    sizes = {**state.error_sds, kind: size}
    components = component_intervals(rig, sizes, "V")
    (component,) = (component for component in components if component["name"] == kind)
    log_width = np.log(component["high"] / component["low"]) / (2.0 * NORMAL_90)
    columns, unit = rig.columns[kind], COMPONENTS[kind].acts_on
    present = np.asarray(columns.any(axis=0))
    count = {
        "whole": 1,
        "channel": present.any(axis=0).sum(),
        "frame": present.any(axis=1).sum(),
        "press": (rig.press_indicator @ present.any(axis=1) > 0.0).sum(),
    }[unit]
    chance_variance = 0.5 / (len(columns) * count)
    if kind == "quadrature":
        chance_variance *= 0.25
    if not component["learned"]:
        return np.inf
    return float(np.sqrt(max(log_width**2 - chance_variance, 0.0)))


def _true(case: cases.Case, error: RigError, seen_mask: np.ndarray) -> float:
    """Root mean square of the errors that were drawn, over what was seen."""
    frames = np.asarray(seen_mask.any(axis=1))
    if USUAL[error.kind].target == "states":
        return _of_states(case, error, frames)
    if error.kind == "quantisation":
        return _rounded(case, error, frames)
    silent = np.zeros_like(case.noise_V)
    rng = np.random.default_rng(0)
    voltage = rig_errors.read(case.clean, [error], case.true_states, silent, rng)
    if error.kind in ("amplitude-per-frame", "gain-walk"):
        largest = [int(np.argmax(np.abs(case.clean[0])))]
        deviation = voltage[:, largest] / case.clean[:, largest] - 1.0
    elif error.kind == "quadrature":
        read = case.clean[0] != 0.0  # an open electrode leaves channels without any
        square = (voltage[0, read] / case.clean[0, read]) ** 2
        return rms(np.sqrt(np.maximum(square - 1.0, 0.0)))
    else:
        deviation = voltage - case.clean
    if error.kind in PATHS:
        all_frames = np.ones(len(frames), bool)
        return rms(_waves(case.true_states, deviation, all_frames, PATHS[error.kind]))
    return rms(deviation[frames])


def _of_states(case: cases.Case, error: RigError, frames: np.ndarray) -> float:
    kind, reported = error.kind, rig_errors.reported(case.true_states, [error])
    touched = case.true_states["touch"].to_numpy(bool)
    # Gaps in a path leave its waves open: it counts as a whole.
    frames = touched if kind in PATHS else frames & touched
    reported_states, true_states = reported[frames], case.true_states[frames]
    keys = ["x_mm", "y_mm"] if kind.startswith("place") else ["force_N"]
    deviation = reported_states[keys] - true_states[keys]
    if kind == "force-per-press":
        deviation = deviation / true_states[keys]
    if kind.endswith("per-press"):
        deviation = deviation.groupby(true_states["contact"]).median()
    if kind in PATHS:
        paths = np.zeros((len(case.states), 1))
        paths[frames] = deviation
        return rms(_waves(case.true_states, paths, frames, PATHS[kind]))
    return rms(deviation.to_numpy(float))


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
    at_rest = frames & ~case.true_states["touch"].to_numpy(bool)
    finer_errors = [rig_error for rig_error in case.rig if rig_error is not error]
    biases = []
    for draw in range(DRAWS):
        rounded, unrounded = (
            _read(case, errors, draw)[at_rest] for errors in (case.rig, finer_errors)
        )
        biases.append(np.nanmean(rounded - unrounded, axis=0))
    return rms(np.mean(biases, axis=0))


def _of_noise(
    case: cases.Case, error: RigError, noise: NoiseModel
) -> tuple[float, float, float, float]:
    """(drawn, true, found, log_sd) of a property of the noise itself."""
    frames, channels = case.clean.shape
    if error.kind == "correlated-noise":
        rho, estimate = error.size, noise.spectrum.lag_one
        lasts = -1.0 / np.log(rho)
        log_sd = lasts / rho * noise.correlation_sd(rho)
        return lasts, lasts, -1.0 / np.log(estimate) if estimate else 0.0, log_sd
    if error.kind == "uneven-noise":
        size, estimate = error.size, np.std(np.log(noise.sd / case.noise_V))
        log_sd = (1.0 + 0.5 / (frames * size**2)) / np.sqrt(2.0 * channels)
        return size, size, estimate, log_sd
    height = np.abs(_read(case, [error], 0) - _read(case, [], 0)) / case.noise_V
    if error.kind == "loud-frames":
        true, estimate = (np.median(height, axis=1) > 0.0).mean(), len(noise.loud_frames) / frames
    else:
        true, estimate = (height > STANDS_OUT).mean(), noise.spike_count / height.size
    return error.size, true, estimate, 0.0 if true else np.inf


def _read(case: cases.Case, errors: Sequence[RigError], seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rig_errors.read(case.clean, errors, case.true_states, case.noise_V, rng)


def table(rows: list[dict]) -> pd.DataFrame:
    """Rows (ROW) counted, one row (TABLE) a kind and one for all: n, those that can be told, and of
    these how many are within WITHIN, with the share's interval, and the median of found over true.
    """
    sizes = pd.DataFrame(rows, columns=list(ROW))
    lines = []
    for kind in ("any", *sorted(sizes["kind"].unique())):
        members = sizes if kind == "any" else sizes[sizes["kind"] == kind]
        tellable = members[members["told"].astype(bool)]
        hits = int(tellable["within"].sum())
        low, high = wilson(hits, len(tellable))
        ratio = (tellable["found"] / tellable["true"]).median()
        values = (kind, len(members), len(tellable), hits, low, high, ratio)
        lines.append(dict(zip(TABLE, values, strict=True)))
    return pd.DataFrame(lines, columns=list(TABLE))


def measured(kind: str, seed: int) -> list[dict]:
    """`compared`, and its seed, of a recording in which nothing is wrong but one kind of error."""
    case = cases.draw(f"null+rig:{kind}", seed)
    recorded = case.recorded
    noise, search, state = calibrated(recorded, 1)
    rows = compared(case, search.problem.whitening.mask, noise, state)
    return [{"seed": seed, **row} for row in rows]


def write(folder: Path, seeds: range) -> None:
    """rows.csv and rig_sizes.csv of some seeds, every kind in turn, into a folder."""
    plan = [(KINDS[seed % len(KINDS)], seed) for seed in seeds]
    rows = [row for trial in plan for row in measured(*trial)]
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in {"rows": pd.DataFrame(rows), "rig_sizes": table(rows)}.items():
        with atomic_path(folder / f"{name}.csv") as path:
            content.to_csv(path, index=False)


if __name__ == "__main__":
    write(Path(sys.argv[1]), range(int(sys.argv[2]), int(sys.argv[3]) + 1))

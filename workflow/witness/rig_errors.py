"""Errors of a rig: noise that is not white, inaccurate robots and load cells, loud frames, lost
readings.

    draw(rng)                                  one to three kinds, each with its size
    reported(states, errors)                   the states as reported by robot and load cell
    read(clean, errors, states, noise_V, rng)  the board's readings from noise-free ones

Sizes are log-uniform from a tenth to three times those of an ordinary rig (`USUAL`); the
correlation of noise is 0.3 to 0.98. No line is shared with the covariance of the diagnosis.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

MIN_SIZE, MAX_SIZE = 0.1, 3.0  # of the usual size
CORRELATIONS = (0.3, 0.98)
MAX_KINDS = 3  # in one recording
LOUD = (10.0, 300.0)  # times the noise, of a loud frame
SPIKES = (0.03, 1.0)  # of the median |v|, of a spike


@dataclass(frozen=True)
class Usual:
    """A kind of error: its size on an ordinary rig, in its unit; target: the readings, or the
    reported states."""

    size: float
    unit: str
    target: str


USUAL = {  # sizes from recordings with such errors, our choice where none is known
    "correlated-noise": Usual(0.9, "1", "readings"),  # from frame to frame, a channel's own
    "common-noise": Usual(5e-4, "median |v|", "readings"),  # of all channels alike, a frame
    "channel-drift": Usual(3e-4, "median |v|", "readings"),  # a slow walk of each channel
    "amplitude-per-frame": Usual(5e-4, "1", "readings"),  # of the source
    "gain-walk": Usual(2e-3, "1", "readings"),  # at the recording's end
    "uneven-noise": Usual(0.5, "1", "readings"),  # logarithm of a channel's noise
    "loud-frames": Usual(2 / 122, "1", "readings"),  # share of the frames
    "spikes": Usual(1e-3, "1", "readings"),  # share of the readings
    "lost-readings": Usual(1e-2, "1", "readings"),  # share of the readings
    "quadrature": Usual(2e-2, "1", "readings"),  # of a reading, in a board's magnitudes
    "quantisation": Usual(1e-3, "median |v|", "readings"),  # a converter's step
    "place-per-frame": Usual(0.5, "mm", "states"),
    "place-per-press": Usual(0.5, "mm", "states"),
    "force-per-frame": Usual(0.05, "N", "states"),
    "force-per-press": Usual(5e-2, "1", "states"),
    "force-zero-walk": Usual(0.1, "N", "states"),  # at the recording's end
}


@dataclass(frozen=True)
class RigError:
    """A kind of error with its size, in the unit of USUAL, and the seed of its random numbers."""

    kind: str
    size: float
    seed: int

    def rng(self) -> np.random.Generator:
        """The generator of its random numbers, the same at each call."""
        return np.random.default_rng([self.seed, list(USUAL).index(self.kind)])


def draw(rng: np.random.Generator, kinds: Sequence[str] | None = None) -> list[RigError]:
    """The errors of a rig: of `kinds`, or of one to three random kinds."""
    if kinds is None:
        number = int(rng.integers(1, MAX_KINDS + 1))
        kinds = rng.choice(sorted(USUAL), number, replace=False).tolist()
    return [RigError(kind, _size(rng, kind), int(rng.integers(2**31))) for kind in kinds]


def _size(rng: np.random.Generator, kind: str) -> float:
    if kind == "correlated-noise":
        return drawn_size(rng, 1.0, CORRELATIONS)
    return drawn_size(rng, USUAL[kind].size)


def drawn_size(
    rng: np.random.Generator, usual: float, band: tuple[float, float] = (MIN_SIZE, MAX_SIZE)
) -> float:
    """A log-uniform size in a band, times the usual one, with three significant digits."""
    low, high = np.log(np.array(band) * usual)
    return float(f"{np.exp(rng.uniform(low, high)):.3g}")


def reported(states: pd.DataFrame, errors: Sequence[RigError]) -> pd.DataFrame:
    """The states in the recording, from the true ones: x_mm, y_mm and force_N with errors where
    touched. Forces are clipped at 0."""
    reported_states = states.copy()
    touched = states["touch"].to_numpy(bool)
    press = pd.factorize(states["contact"].to_numpy())[0]
    share = elapsed_share(states)
    for error in errors:
        rng, size = error.rng(), error.size
        if error.kind in ("place-per-frame", "place-per-press"):
            count = len(states) if error.kind == "place-per-frame" else press.max() + 1
            shift = size * rng.standard_normal((count, 2))
            shift = shift if error.kind == "place-per-frame" else shift[press]
            reported_states["x_mm"] += np.where(touched, shift[:, 0], 0.0)
            reported_states["y_mm"] += np.where(touched, shift[:, 1], 0.0)
        elif error.kind == "force-per-frame":
            reported_states["force_N"] += np.where(
                touched, size * rng.standard_normal(len(states)), 0.0
            )
        elif error.kind == "force-per-press":
            factor = 1.0 + size * rng.standard_normal(press.max() + 1)
            reported_states["force_N"] *= np.where(touched, factor[press], 1.0)
        elif error.kind == "force-zero-walk":
            reported_states["force_N"] += np.where(touched, size * walk(rng, share)[:, 0], 0.0)
    reported_states["force_N"] = reported_states["force_N"].clip(lower=0.0)
    return reported_states


def read(
    clean: np.ndarray,
    errors: Sequence[RigError],
    states: pd.DataFrame,
    noise_V: np.ndarray,
    rng: np.random.Generator,
) -> np.ndarray:
    """Noisy readings (N, M) V from noise-free ones (N, M) V; NaN where lost.

    noise_V (M,): sd of the noise, drawn with `rng`; without errors it is white. It is added before
    the converter and before magnitudes are taken.
    """
    error_by_kind = {error.kind: error for error in errors}
    median = float(np.median(np.abs(clean[0])))
    share = elapsed_share(states)
    voltage = clean.copy()
    if (error := error_by_kind.get("amplitude-per-frame")) is not None:
        voltage *= 1.0 + error.size * error.rng().standard_normal((len(clean), 1))
    if (error := error_by_kind.get("gain-walk")) is not None:
        voltage *= 1.0 + error.size * walk(error.rng(), share)
    voltage += noise_V * _noise(error_by_kind, rng.standard_normal(clean.shape))
    if (error := error_by_kind.get("common-noise")) is not None:
        voltage += error.size * median * error.rng().standard_normal((len(clean), 1))
    if (error := error_by_kind.get("channel-drift")) is not None:
        voltage += error.size * median * walk(error.rng(), share, clean.shape[1])
    if (error := error_by_kind.get("loud-frames")) is not None:
        rng = error.rng()
        loud = rng.choice(len(clean), max(1, round(error.size * len(clean))), replace=False)
        low, high = np.log(LOUD)
        louder = np.exp(rng.uniform(low, high, (len(loud), 1)))
        voltage[loud] += louder * noise_V * rng.standard_normal((len(loud), clean.shape[1]))
    if (error := error_by_kind.get("spikes")) is not None:
        rng = error.rng()
        is_spike = rng.uniform(size=clean.shape) < error.size
        low, high = np.log(SPIKES)
        height = median * np.exp(rng.uniform(low, high, clean.shape))
        voltage += np.where(is_spike, height * rng.choice([-1.0, 1.0], clean.shape), 0.0)
    if (error := error_by_kind.get("quadrature")) is not None:
        across = error.size * np.abs(clean) * error.rng().standard_normal(clean.shape[1])
        voltage = np.hypot(voltage, across)
    if (error := error_by_kind.get("quantisation")) is not None:
        step = error.size * median
        voltage = step * np.round(voltage / step)
    if (error := error_by_kind.get("lost-readings")) is not None:
        voltage[error.rng().uniform(size=clean.shape) < error.size] = np.nan
    return voltage


def magnitudes(errors: Sequence[RigError]) -> bool:
    """Whether the board reports magnitudes."""
    return any(error.kind == "quadrature" for error in errors)


def _noise(error_by_kind: dict[str, RigError], white: np.ndarray) -> np.ndarray:
    """(N, M): the noise of each channel over its sd, of white noise (N, M)."""
    if (error := error_by_kind.get("correlated-noise")) is not None:
        rho, correlated = error.size, white.copy()
        for row in range(1, len(white)):
            correlated[row] = rho * correlated[row - 1] + np.sqrt(1.0 - rho**2) * white[row]
        white = correlated
    if (error := error_by_kind.get("uneven-noise")) is not None:
        white = white * np.exp(error.size * error.rng().standard_normal(white.shape[1]))
    return white


def elapsed_share(states: pd.DataFrame) -> np.ndarray:
    """(N,): the elapsed share of the recording's time."""
    time = states["time_s"].to_numpy(float)
    return (time - time[0]) / max(float(np.ptp(time)), 1e-9)


def walk(rng: np.random.Generator, share: np.ndarray, count: int = 1) -> np.ndarray:
    """(N, count): random walks from 0, of sd 1 at the end."""
    step = np.sqrt(np.diff(share, prepend=0.0))[:, None]
    return np.cumsum(step * rng.standard_normal((len(share), count)), axis=0)

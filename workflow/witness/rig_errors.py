"""What every rig adds to a recording and nobody wants named: noise that is not white, a robot and a
load cell that miss, loud frames, lost ones.

    draw(rng)                                  one to three kinds, each with its size
    reported(states, errors)                   the states as robot and load cell tell them
    read(clean, errors, states, noise_V, rng)  what the board makes of noise-free readings

Sizes are log-uniform from a tenth to three times what an ordinary rig has (`USUAL`); the
correlation of noise from 0.3 to 0.98. No line of this is shared with the diagnosis' covariance.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

LEAST, MOST = 0.1, 3.0  # of the usual size
CORRELATIONS = (0.3, 0.98)
TOGETHER = 3  # kinds in one recording, at most
LOUD = (10.0, 300.0)  # times the noise, of a loud frame
SPIKES = (0.03, 1.0)  # of the median |v|, of a spike


@dataclass(frozen=True)
class Usual:
    """A kind of error: what its size is on an ordinary rig, in its unit; of: what it falls on, the
    readings or the states reported."""

    size: float
    unit: str
    of: str


USUAL = {  # sizes from the recordings that went wrong, ours where none is known
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
    """One kind at a size, in the unit that USUAL says; seed: of all that it draws."""

    kind: str
    size: float
    seed: int

    def rng(self) -> np.random.Generator:
        """The same numbers each time."""
        return np.random.default_rng([self.seed, list(USUAL).index(self.kind)])


def draw(rng: np.random.Generator, kinds: Sequence[str] | None = None) -> list[RigError]:
    """Errors of a rig: those of `kinds`, or one to three kinds drawn."""
    if kinds is None:
        number = int(rng.integers(1, TOGETHER + 1))
        kinds = rng.choice(sorted(USUAL), number, replace=False).tolist()
    return [RigError(kind, _size(rng, kind), int(rng.integers(2**31))) for kind in kinds]


def _size(rng: np.random.Generator, kind: str) -> float:
    usual = USUAL[kind].size
    band = CORRELATIONS if kind == "correlated-noise" else (LEAST * usual, MOST * usual)
    return float(f"{np.exp(rng.uniform(*np.log(band))):.3g}")


def reported(states: pd.DataFrame, errors: Sequence[RigError]) -> pd.DataFrame:
    """The states that stand in the recording, of those at which the skin was read: x_mm, y_mm and
    force_N moved where touched. No force is negative."""
    told = states.copy()
    touched = states["touch"].to_numpy(bool)
    press = pd.factorize(states["contact"].to_numpy())[0]
    share = _share(states)
    for error in errors:
        rng, size = error.rng(), error.size
        if error.kind in ("place-per-frame", "place-per-press"):
            count = len(states) if error.kind == "place-per-frame" else press.max() + 1
            shift = size * rng.standard_normal((count, 2))
            shift = shift if error.kind == "place-per-frame" else shift[press]
            told["x_mm"] += np.where(touched, shift[:, 0], 0.0)
            told["y_mm"] += np.where(touched, shift[:, 1], 0.0)
        elif error.kind == "force-per-frame":
            told["force_N"] += np.where(touched, size * rng.standard_normal(len(states)), 0.0)
        elif error.kind == "force-per-press":
            factor = 1.0 + size * rng.standard_normal(press.max() + 1)
            told["force_N"] *= np.where(touched, factor[press], 1.0)
        elif error.kind == "force-zero-walk":
            told["force_N"] += np.where(touched, size * _walk(rng, share)[:, 0], 0.0)
    told["force_N"] = told["force_N"].clip(lower=0.0)
    return told


def read(
    clean: np.ndarray,
    errors: Sequence[RigError],
    states: pd.DataFrame,
    noise_V: np.ndarray,
    rng: np.random.Generator,
) -> np.ndarray:
    """Readings (N, M) V, noise and all, of noise-free ones (N, M) V; NaN where lost.

    noise_V (M,): sd of the noise, which `rng` draws; without errors it is white. It comes before
    the converter, and before magnitudes are taken.
    """
    of = {error.kind: error for error in errors}
    median = float(np.median(np.abs(clean[0])))
    share = _share(states)
    voltage = clean.copy()
    if (error := of.get("amplitude-per-frame")) is not None:
        voltage *= 1.0 + error.size * error.rng().standard_normal((len(clean), 1))
    if (error := of.get("gain-walk")) is not None:
        voltage *= 1.0 + error.size * _walk(error.rng(), share)
    voltage += noise_V * _noise(of, rng.standard_normal(clean.shape))
    if (error := of.get("common-noise")) is not None:
        voltage += error.size * median * error.rng().standard_normal((len(clean), 1))
    if (error := of.get("channel-drift")) is not None:
        voltage += error.size * median * _walk(error.rng(), share, clean.shape[1])
    if (error := of.get("loud-frames")) is not None:
        rng = error.rng()
        loud = rng.choice(len(clean), max(1, round(error.size * len(clean))), replace=False)
        low, high = np.log(LOUD)
        louder = np.exp(rng.uniform(low, high, (len(loud), 1)))
        voltage[loud] += louder * noise_V * rng.standard_normal((len(loud), clean.shape[1]))
    if (error := of.get("spikes")) is not None:
        rng = error.rng()
        hit = rng.uniform(size=clean.shape) < error.size
        low, high = np.log(SPIKES)
        height = median * np.exp(rng.uniform(low, high, clean.shape))
        voltage += np.where(hit, height * rng.choice([-1.0, 1.0], clean.shape), 0.0)
    if (error := of.get("quadrature")) is not None:
        across = error.size * np.abs(clean) * error.rng().standard_normal(clean.shape[1])
        voltage = np.hypot(voltage, across)
    if (error := of.get("quantisation")) is not None:
        step = error.size * median
        voltage = step * np.round(voltage / step)
    if (error := of.get("lost-readings")) is not None:
        voltage[error.rng().uniform(size=clean.shape) < error.size] = np.nan
    return voltage


def magnitudes(errors: Sequence[RigError]) -> bool:
    """Whether the board takes magnitudes."""
    return any(error.kind == "quadrature" for error in errors)


def _noise(of: dict[str, RigError], white: np.ndarray) -> np.ndarray:
    """(N, M): the noise of each channel over its sd, of white noise (N, M)."""
    if (error := of.get("correlated-noise")) is not None:
        rho, made = error.size, white.copy()
        for row in range(1, len(white)):
            made[row] = rho * made[row - 1] + np.sqrt(1.0 - rho**2) * white[row]
        white = made
    if (error := of.get("uneven-noise")) is not None:
        white = white * np.exp(error.size * error.rng().standard_normal(white.shape[1]))
    return white


def _share(states: pd.DataFrame) -> np.ndarray:
    """(N,): how much of the recording's time has gone."""
    time = states["time_s"].to_numpy(float)
    return (time - time[0]) / max(float(np.ptp(time)), 1e-9)


def _walk(rng: np.random.Generator, share: np.ndarray, count: int = 1) -> np.ndarray:
    """(N, count): random walks from 0, of sd 1 at the end."""
    step = np.sqrt(np.diff(share, prepend=0.0))[:, None]
    return np.cumsum(step * rng.standard_normal((len(share), count)), axis=0)

"""How far a skin's readings wander without a fault, from the scatter within two sessions.

In units of each channel's white noise, the means of blocks of frames scatter along a few directions
(what dries, warms or settles moves many channels at once) and, across these, a little in every
channel. What two sessions differ by is of the same kind, by an unknown factor: along the directions
and by a common gain it may be of any size, across them its size is that of the scatter or more.
"""

import math
from dataclasses import dataclass

import numpy as np

BLOCK = 5  # frames whose mean is one sample of the wandering
MOST_BLOCKS = 16  # of a session
ROUNDING = 1e-6  # of a reading, of the noise where there is none
SPIKE = 5.0  # sd from a session's median at which a reading is held
JUMP = 8.0  # white sd, of a step that noise does not give
LOUD = 0.2  # of the channels that step in a loud frame
EDGE = 1.5  # times what white noise alone gives a direction
SHARED = 4.0  # samples that the scatter of all channels counts for in each one's
WALK = 4.0  # variance between the means of two sessions, over that within one, of a random walk
MOST_KEPT = 0.95  # of a covariance between channels
PRIOR = 20.0  # channels that the scatter within sessions counts for in that between them


@dataclass(frozen=True)
class Wander:
    """The difference of two sessions, in units of what it would be without a fault.

    usable (M,): channels read in both; mean (M,), change (M,): of the control, and from it to the
    later session, V; noise (M,), scale (M,): a frame's white noise and the wandering of the
    difference, V; nuisance (M, q): orthonormal, in units of scale, what a skin does without a
    fault; prior: how many channels' worth is known of the scale. What is not usable is 0 or, of
    scale, infinite.
    """

    usable: np.ndarray
    mean: np.ndarray
    change: np.ndarray
    noise: np.ndarray
    scale: np.ndarray
    nuisance: np.ndarray
    turn: np.ndarray
    eased: np.ndarray
    prior: float

    @property
    def count(self) -> int:
        """Free values of the difference."""
        return int(self.usable.sum()) - self.nuisance.shape[1]

    @property
    def moved(self) -> float:
        """The rms of the difference, in units of scale, of what a skin does not do by itself; NaN
        where no value is free."""
        if self.count < 1:
            return math.nan
        return float(np.linalg.norm(self.across(self.change)) / np.sqrt(self.count))

    def across(self, values: np.ndarray) -> np.ndarray:
        """Values (M,) or (M, k), V, in units of scale, without what a skin does without a fault."""
        white = values / (self.scale if values.ndim == 1 else self.scale[:, None])
        white = _eased(white, self.turn, self.eased)
        return white - self.nuisance @ (self.nuisance.T @ white)


def _eased(white: np.ndarray, turn: np.ndarray, eased: np.ndarray) -> np.ndarray:
    """Values (M,) or (M, k) times the inverse root of the covariance of unit channels."""
    along = turn.T @ white
    return white - turn @ ((1.0 - eased) * along.T).T


def wander(control: np.ndarray, later: np.ndarray) -> Wander:
    """Of two sessions' untouched readings (N, M), (N', M), NaN where lost, one frame or more each.

    A channel that either session lost in more than half of its frames is not usable.
    """
    usable = np.isfinite(control).mean(axis=0) >= 0.5
    usable &= np.isfinite(later).mean(axis=0) >= 0.5
    sessions = [_held(each[:, usable]) for each in (control, later)]
    mean, after = (each.mean(axis=0) for each in sessions)
    noise, known = _white(sessions, mean)
    white = [each / noise for each in sessions]
    scale, directions, samples = _scatter(white)
    scale = np.hypot(scale, _jumps(white))
    scale = scale * noise
    turn, eased = _together(samples)
    found = np.column_stack([mean / scale, noise[:, None] * directions / scale[:, None]])
    nuisance = np.linalg.qr(_eased(found, turn, eased))[0]

    def everywhere(values: np.ndarray, other: float = 0.0) -> np.ndarray:
        full = np.full((len(usable), *values.shape[1:]), other)
        full[usable] = values
        return full

    return Wander(
        usable,
        everywhere(mean),
        everywhere(after - mean),
        everywhere(noise),
        everywhere(scale, np.inf),
        everywhere(nuisance),
        everywhere(turn),
        eased,
        min(PRIOR, known),
    )


def _held(readings: np.ndarray) -> np.ndarray:
    """With the median for what was lost, and spikes cut."""
    middle = np.nanmedian(readings, axis=0)
    spread = 1.4826 * np.nanmedian(np.abs(readings - middle), axis=0)
    filled = np.where(np.isfinite(readings), readings, middle)
    far = np.where(spread > 0, SPIKE * spread, np.inf)
    return np.clip(filled, middle - far, middle + far)


def _white(sessions: list[np.ndarray], mean: np.ndarray) -> tuple[np.ndarray, int]:
    """Sd of a frame's noise in each channel (M,), from steps between neighbouring frames, and how
    many steps; of too few, what half a constant and half a share of the reading would be."""
    level = np.abs(mean)
    shape = 0.5 * (level + np.median(level[level > 0])) if level.any() else np.ones(len(level))
    steps = np.concatenate([np.diff(each, axis=0) for each in sessions])
    if not len(steps):
        return shape, 0
    square = 0.5 * (steps**2).mean(axis=0)
    if len(steps) >= 8:
        square = 0.5 * (1.4826 * np.median(np.abs(steps), axis=0)) ** 2
    ratio = np.median(square / shape**2) or (square / shape**2).mean() or ROUNDING**2
    weight = len(steps) / (len(steps) + SHARED)
    return np.sqrt(weight * square + (1.0 - weight) * ratio * shape**2), len(steps)


def _jumps(sessions: list[np.ndarray]) -> np.ndarray:
    """The second largest of a channel's own steps (M,), 0 below JUMP: what steps to and fro within
    a session, does between two; a fault that begins steps once. What steps in many channels at once
    is a loud frame."""
    steps = np.abs(np.concatenate([np.diff(each, axis=0) for each in sessions]))
    if len(steps) < 2:
        return np.zeros(steps.shape[1])
    steps = steps[(steps > JUMP).mean(axis=1) < LOUD]
    second = np.sort(steps, axis=0)[-2] if len(steps) > 1 else np.zeros(steps.shape[1])
    return np.where(second > JUMP, second, 0.0)


def _blocks(session: np.ndarray) -> np.ndarray:
    """Means of blocks of frames, about the session's own mean."""
    parts = np.clip(len(session) // BLOCK, 1, MOST_BLOCKS)
    means = np.array([part.mean(axis=0) for part in np.array_split(session, parts)])
    return means - means.mean(axis=0)


def _scatter(sessions: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sd of the difference of the sessions' means in each channel across the directions (M,), those
    (M, q), both in units of white noise; samples (s, M) of the rest, each channel in units of its
    own, the squares of which add to the number of free ones."""
    white = sum(1.0 / len(each) for each in sessions)
    blocks = np.concatenate([_blocks(each) for each in sessions])
    count, width = blocks.shape
    free = count - len(sessions)
    if free < 1:
        return np.full(width, np.sqrt(white)), np.zeros((width, 0)), np.zeros((0, width))
    length = sum(map(len, sessions)) / count
    _, sizes, rows = np.linalg.svd(blocks, full_matrices=False)
    edge = EDGE * (np.sqrt(free) + np.sqrt(width)) / np.sqrt(length)
    most = min(free // 2, width // 6)
    kept = min(int((sizes > edge).sum()), most)
    directions = rows[:kept].T
    rest = blocks - (blocks @ directions) @ directions.T
    left = max(free - kept, 1)
    square = (rest**2).sum(axis=0) / left
    square = (left * square + SHARED * square.mean()) / (left + SHARED)
    walked = WALK * np.maximum(square - 1.0 / length, 0.0)
    spread = np.sqrt(square * left / len(rest))
    return np.sqrt(walked + white), directions, rest / np.where(spread > 0, spread, 1.0)


def _together(samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Directions (M, s) in which channels scatter together, from samples (s, M), and the roots (s,)
    of what channels by themselves scatter over that along them: the covariance is shrunk towards
    independent channels as far as chance asks for (Ledoit & Wolf 2004)."""
    count, width = samples.shape
    if count < 2:
        return np.zeros((width, 0)), np.zeros(0)
    gram = samples @ samples.T / count
    square = (gram**2).sum() / width
    apart = square - 1.0
    by_chance = (np.diag(gram) ** 2).sum() / width - square / count
    kept = float(np.clip(1.0 - by_chance / apart, 0.0, MOST_KEPT)) if apart > 0 else 0.0
    size, rows = np.linalg.eigh(gram)
    there = size > 1e-9 * size.max()
    turn = samples.T @ rows[:, there] / np.sqrt(count * size[there])
    return turn, np.sqrt((1.0 - kept) / (1.0 - kept + kept * size[there]))

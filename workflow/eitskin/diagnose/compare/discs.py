"""Discs in a skin of radius 1, and the coordinates by which they are fitted.

A disc has four coordinates: two for its centre, unbounded, which keep it within the rim, and the
logarithms of its radius and of its conductivity over the skin's.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, log, sqrt

import numpy as np

FREE = 4  # coordinates of a disc
REACH = 0.98  # of the way to the rim, that a disc's edge comes to: contacts lie on the rim itself
LEAST_RADIUS, MOST_RADIUS = 0.03, 0.5  # smaller ones act as points, larger ones are no objects
MOST_LOG_RATIO = 6.0  # 400 times: beyond it a disc acts as metal or air does
MOST_CENTRE = 9.0  # of a centre's coordinates: 0.994 of its reach
LEAST_LOG_RATIO = 1e-3  # that a fit keeps from 1: the other sign is an explanation of its own
SEPARATION = 0.1  # of the smaller radius, between two discs: the solver's patches may not touch
STRONG_LOG_RATIO = 4.0  # 55 times: nearly as metal or air
NORMAL_90 = 1.645  # half a 90 % interval of a normal variable, in sd


@dataclass(frozen=True)
class Disc:
    """x, y, radius in units of the skin's radius; ratio: conductivity inside over outside."""

    x: float
    y: float
    radius: float
    ratio: float

    @property
    def conducting(self) -> bool:
        """Whether it conducts better than the skin."""
        return self.ratio > 1.0

    @property
    def angle_deg(self) -> float:
        """Angle of the centre, as angles of electrodes are counted."""
        return float(np.degrees(np.arctan2(self.y, self.x)) % 360.0)


def discs_at(coordinates: np.ndarray) -> list[Disc]:
    """Discs at coordinates (4 k,)."""
    discs = []
    for a, b, log_radius, log_ratio in coordinates.reshape(-1, FREE).tolist():
        radius = exp(log_radius)
        scale = REACH * (1.0 - radius) / sqrt(1.0 + a * a + b * b)
        discs.append(Disc(a * scale, b * scale, radius, exp(log_ratio)))
    return discs


def coordinates_of(disc: Disc) -> np.ndarray:
    """Coordinates (4,) of a disc within the rim."""
    centre = np.array([disc.x, disc.y]) / (REACH * (1.0 - disc.radius))
    unbounded = centre / np.sqrt(1.0 - min(float(centre @ centre), 0.98))
    return np.array([*unbounded, log(disc.radius), log(disc.ratio)])


def derivatives_at(coordinates: np.ndarray) -> np.ndarray:
    """Derivatives (4 k, 4 k) of x, y, radius and ratio of discs by their coordinates (4 k,)."""
    derivatives = np.zeros((len(coordinates), len(coordinates)))
    centres = coordinates.reshape(-1, FREE)
    for i, (disc, (a, b, _, _)) in enumerate(zip(discs_at(coordinates), centres, strict=True)):
        square = 1.0 + a * a + b * b
        scale = REACH * (1.0 - disc.radius) / np.sqrt(square)
        block = np.zeros((FREE, FREE))
        block[:2, :2] = scale * (np.eye(2) - np.outer([a, b], [a, b]) / square)
        block[:2, 2] = -REACH * disc.radius / np.sqrt(square) * np.array([a, b])
        block[2, 2], block[3, 3] = disc.radius, disc.ratio
        derivatives[FREE * i : FREE * (i + 1), FREE * i : FREE * (i + 1)] = block
    return derivatives


def bounds(coordinates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest coordinates (4 k,) of a fit that starts at some, each ratio on its side of
    1."""
    low, high = [], []
    for log_ratio in coordinates.reshape(-1, FREE)[:, 3]:
        low += [-MOST_CENTRE, -MOST_CENTRE, log(LEAST_RADIUS)]
        high += [MOST_CENTRE, MOST_CENTRE, log(MOST_RADIUS)]
        low.append(LEAST_LOG_RATIO if log_ratio > 0 else -MOST_LOG_RATIO)
        high.append(MOST_LOG_RATIO if log_ratio > 0 else -LEAST_LOG_RATIO)
    return np.array(low), np.array(high)


def overlapping(discs: Sequence[Disc]) -> bool:
    """Whether any two discs overlap or nearly touch."""
    return any(
        np.hypot(a.x - b.x, a.y - b.y) < a.radius + b.radius + SEPARATION * min(a.radius, b.radius)
        for i, a in enumerate(discs)
        for b in discs[:i]
    )


def halves(disc: Disc) -> list[list[Disc]]:
    """Two small strong discs within one, side by side along the rim, or one behind the other."""
    outwards = complex(disc.x, disc.y) / (np.hypot(disc.x, disc.y) or 1.0)
    pairs = []
    for step in (0.55j * disc.radius * outwards, 0.55 * disc.radius * outwards):
        centres = (complex(disc.x, disc.y) + sign * step for sign in (1.0, -1.0))
        radius = max(0.35 * disc.radius, LEAST_RADIUS)
        ratio = float(np.exp(STRONG_LOG_RATIO if disc.conducting else -STRONG_LOG_RATIO))
        pairs.append([Disc(z.real, z.imag, radius, ratio) for z in centres])
    return pairs


def intervals(
    coordinates: np.ndarray, sd: np.ndarray
) -> list[dict[str, tuple[float, float, float]]]:
    """Value, low and high (90 %, to first order) of x, y, radius and ratio of discs at coordinates
    (4 k,) with standard deviations (4 k,).

    A ratio stays on its side of 1; one that reaches its bound has no end there: 0 or infinity.
    """
    estimates = []
    slopes = np.abs(derivatives_at(coordinates))
    for i, disc in enumerate(discs_at(coordinates)):
        rows = slice(FREE * i, FREE * i + 2)
        half = NORMAL_90 * np.sqrt((slopes[rows] ** 2) @ sd**2)
        log_radius, log_ratio = coordinates[FREE * i + 2], coordinates[FREE * i + 3]
        half_radius, half_ratio = NORMAL_90 * sd[FREE * i + 2 : FREE * i + 4]
        low, high = log_ratio - half_ratio, log_ratio + half_ratio
        low, high = (max(low, 0.0), high) if disc.conducting else (low, min(high, 0.0))
        estimates.append(
            {
                "x": (disc.x, disc.x - half[0], disc.x + half[0]),
                "y": (disc.y, disc.y - half[1], disc.y + half[1]),
                "radius": (
                    disc.radius,
                    *np.exp([log_radius - half_radius, log_radius + half_radius]),
                ),
                "ratio": (
                    disc.ratio,
                    float(np.exp(low)) if low > -MOST_LOG_RATIO else 0.0,
                    float(np.exp(high)) if high < MOST_LOG_RATIO else np.inf,
                ),
            }
        )
    return estimates

"""Angles on the unit disc close to a corner of the rim.

A corner of angle alpha is opened to a straight line: theta = theta_c +- c l^(pi / alpha) at the
length l on either side. The conformal map is known to its defect, which is more than this angle
very near the corner; the law takes over where both are off by as much.
"""

import numpy as np

from eitskin.physics.conformal import DiscMap, MapVelocity
from eitskin.physics.geometry import Geometry, RimMotion

BESIDE = 1e-9  # radians from a corner, at which its sides have their directions
ROOM_SHARE = 0.25  # of the nearer corner's distance, from which the law's reach is looked for
REACHES = 10.0 ** (-0.25 * np.arange(48))  # of that distance
SIGNS = np.array([1.0, -1.0])  # of the sides behind and before a corner


class CornerLaw:
    """The law at one corner, at angle phi of the rim. Sides are 0 behind the corner, 1 before it.

    theta: the corner's angle on the disc; power: pi / alpha; reach_mm: unfolded length within which
    the law holds.
    """

    def __init__(self, geometry: Geometry, disc: DiscMap, phi: float):
        assert geometry.outline is not None
        self.geometry, self.disc = geometry, disc
        self._sides = phi + BESIDE * SIGNS
        self._direction = geometry.unfold(geometry.rim(self._sides, 1))
        self._speed = np.abs(self._direction)
        turn = np.angle(self._direction[0] / self._direction[1])
        self.power = float(np.pi / (np.pi - turn))
        apart = np.abs((geometry.outline.corner_phi - phi + np.pi) % (2.0 * np.pi) - np.pi)
        room = ROOM_SHARE * float(apart[apart > BESIDE].min(initial=np.pi))
        lengths = room * self._speed.min() * REACHES
        places = phi + SIGNS[:, None] * lengths / self._speed[:, None]
        mapped = disc(geometry.unfold(geometry.rim(places)))
        half_angle = 0.5 * np.angle(mapped[0] / mapped[1])
        least = np.sqrt(disc.defect * half_angle[0])
        last = int(np.flatnonzero(half_angle > least).max(initial=0))
        self.reach_mm, self._half_angle = float(lengths[last]), float(half_angle[last])
        self._places = places[:, last]
        self.theta = float(np.angle(mapped[1, last]) + self._half_angle)

    def lengths(self, distance: np.ndarray, side: int) -> np.ndarray:
        """Unfolded lengths, mm, of points at distances of phi on a side."""
        return self._speed[side] * distance

    def angles(self, distance: np.ndarray, side: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Angles theta from the corner's, and their first and second derivatives by phi, of points
        at distances of phi on a side."""
        share = self.lengths(distance, side) / self.reach_mm
        angle = self._half_angle * share**self.power
        slope = self.power * angle / distance
        bend = (self.power - 1.0) * slope / distance
        return SIGNS[side] * angle, slope, SIGNS[side] * bend

    def motion(self, motion: RimMotion, map_velocity: MapVelocity) -> "CornerMotion":
        """The velocity of the law with one of the rim or the unfolding."""
        g = self.geometry
        change = g.unfold(motion.rim(self._sides, 1)) + motion.unfolding(g.rim(self._sides, 1))
        growth = change / self._direction
        turning = growth.imag[0] - growth.imag[1]
        rim = g.rim(self._places)
        z, z_dot = g.unfold(rim), g.unfold(motion.rim(self._places)) + motion.unfolding(rim)
        f, f_slope = self.disc.derivatives(z, 1)
        turn = ((f_slope * z_dot + map_velocity.derivatives(z, 0)[0]) / f).imag
        unlike = 0.5 * self.power * (growth.real[0] - growth.real[1])
        theta = float(turn.mean() - self._half_angle * unlike)
        return CornerMotion(
            self, theta, SIGNS * (turn - theta) / self._half_angle, self.power**2 * turning / np.pi
        )


class CornerMotion:
    """The velocity of a CornerLaw: of the corner's angle, of ln of the angles from it on each side
    at the law's reach, and of the power."""

    def __init__(self, law: CornerLaw, theta: float, rates: np.ndarray, power: float):
        self._law, self._theta, self._rates, self._power = law, theta, rates, power

    def angles(self, distance: np.ndarray, side: int) -> tuple[np.ndarray, np.ndarray]:
        """Velocities of the angles theta and of their derivatives by phi, of points at distances
        of phi on a side."""
        angle, slope, _ = self._law.angles(distance, side)
        within = np.log(self._law.lengths(distance, side) / self._law.reach_mm)
        rate = self._rates[side] + self._power * within
        return self._theta + angle * rate, slope * (rate + self._power / self._law.power)

"""How a tool moves: paths of constant acceleration, piece by piece."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Piece:
    """From `start` s on: pose (6,) m and rotation vector, velocity (6,), acceleration (6,)."""

    start: float
    pose: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray

    def at(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        """Pose and velocity at t s."""
        after = max(t - self.start, 0.0)
        velocity = self.velocity + self.acceleration * after
        return self.pose + (self.velocity + 0.5 * self.acceleration * after) * after, velocity


@dataclass(frozen=True)
class Motion:
    """Pieces in order of time; after the last one the tool rests, unless that one moves on."""

    pieces: tuple[Piece, ...]

    @classmethod
    def rest(cls, pose: np.ndarray) -> "Motion":
        """No motion, at `pose`."""
        pose = np.asarray(pose, dtype=float)
        return cls((Piece(-np.inf, pose, np.zeros(6), np.zeros(6)),))

    @property
    def end(self) -> float:
        """s, when the tool comes to rest; infinite where it never does."""
        return np.inf if self.pieces[-1].velocity.any() else self.pieces[-1].start

    def at(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        """Pose (6,) and velocity (6,) at t s."""
        piece = self.pieces[0]
        for later in self.pieces[1:]:
            if later.start > t:
                break
            piece = later
        if not (piece.velocity.any() or piece.acceleration.any()):
            return piece.pose, piece.velocity
        return piece.at(t)

    def moving(self, t: float) -> bool:
        """Whether the tool moves at t s."""
        return t < self.end


def line(
    pose: np.ndarray, target: np.ndarray, speed: float, acceleration: float, t: float
) -> Motion:
    """Motion from rest at `pose` straight to `target` (6,), a trapezoid of speed (m/s, m/s²).

    Where only the tool's direction changes, speed and acceleration are rad/s and rad/s².
    """
    pose, target = np.asarray(pose, dtype=float), np.asarray(target, dtype=float)
    way = target - pose
    length = float(np.linalg.norm(way[:3]) or np.linalg.norm(way[3:]))
    if length < 1e-9:
        return Motion.rest(target)
    top = min(speed, np.sqrt(acceleration * length))
    ramp = top / acceleration
    cruise = (length - top * ramp) / top
    unit = way / length
    up = Piece(t, pose, np.zeros(6), unit * acceleration)
    level = Piece(t + ramp, up.at(t + ramp)[0], unit * top, np.zeros(6))
    down_at = t + ramp + cruise
    down = Piece(down_at, level.at(down_at)[0], unit * top, -unit * acceleration)
    still = Piece(down_at + ramp, target, np.zeros(6), np.zeros(6))
    return Motion((up, level, down, still))


def change_speed(motion: Motion, velocity: np.ndarray, acceleration: float, t: float) -> Motion:
    """Motion from where `motion` is at t s to a constant velocity (6,), at an acceleration of m/s²
    (rad/s² where only the direction changes)."""
    pose, now = motion.at(t)
    change = np.asarray(velocity, dtype=float) - now
    size = float(np.linalg.norm(change[:3]) or np.linalg.norm(change[3:]))
    if size < 1e-12:
        return Motion((Piece(t, pose, np.asarray(velocity, dtype=float), np.zeros(6)),))
    lasts = size / acceleration
    turn = Piece(t, pose, now, change / lasts)
    then = Piece(t + lasts, turn.at(t + lasts)[0], np.asarray(velocity, dtype=float), np.zeros(6))
    return Motion((turn, then))


def stop(motion: Motion, deceleration: float, t: float) -> Motion:
    """Motion from where `motion` is at t s to rest, at m/s²."""
    return change_speed(motion, np.zeros(6), deceleration, t)

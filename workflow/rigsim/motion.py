"""Motions of a tool: piecewise constant acceleration."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Piece:
    """The motion from `start` s on: pose (6,) in m and as rotation vector, velocity (6,),
    acceleration (6,)."""

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
    """Pieces in order of time; the last one is at rest, or has a constant velocity."""

    pieces: tuple[Piece, ...]

    @classmethod
    def rest(cls, pose: np.ndarray) -> "Motion":
        """The motion at rest at `pose`."""
        pose = np.asarray(pose, dtype=float)
        return cls((Piece(-np.inf, pose, np.zeros(6), np.zeros(6)),))

    @property
    def end(self) -> float:
        """The time s at which the tool comes to rest; infinite where it never does."""
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
    """Motion from rest at `pose` straight to `target` (6,) with a trapezoidal speed (m/s, m/s²).

    Where only the tool's direction changes, speed and acceleration are rad/s and rad/s².
    """
    pose, target = np.asarray(pose, dtype=float), np.asarray(target, dtype=float)
    displacement = target - pose
    length = float(np.linalg.norm(displacement[:3]) or np.linalg.norm(displacement[3:]))
    if length < 1e-9:
        return Motion.rest(target)
    top_speed = min(speed, np.sqrt(acceleration * length))
    ramp = top_speed / acceleration
    cruise = (length - top_speed * ramp) / top_speed
    unit = displacement / length
    acceleration_piece = Piece(t, pose, np.zeros(6), unit * acceleration)
    cruise_piece = Piece(
        t + ramp, acceleration_piece.at(t + ramp)[0], unit * top_speed, np.zeros(6)
    )
    braking_start = t + ramp + cruise
    braking_piece = Piece(
        braking_start, cruise_piece.at(braking_start)[0], unit * top_speed, -unit * acceleration
    )
    end_piece = Piece(braking_start + ramp, target, np.zeros(6), np.zeros(6))
    return Motion((acceleration_piece, cruise_piece, braking_piece, end_piece))


def change_speed(motion: Motion, velocity: np.ndarray, acceleration: float, t: float) -> Motion:
    """Motion from the state of `motion` at t s to a constant velocity (6,), with an acceleration in
    m/s² (rad/s² where only the direction changes)."""
    pose, current_velocity = motion.at(t)
    change = np.asarray(velocity, dtype=float) - current_velocity
    size = float(np.linalg.norm(change[:3]) or np.linalg.norm(change[3:]))
    if size < 1e-12:
        return Motion((Piece(t, pose, np.asarray(velocity, dtype=float), np.zeros(6)),))
    duration = size / acceleration
    change_piece = Piece(t, pose, current_velocity, change / duration)
    end_piece = Piece(
        t + duration,
        change_piece.at(t + duration)[0],
        np.asarray(velocity, dtype=float),
        np.zeros(6),
    )
    return Motion((change_piece, end_piece))


def stop(motion: Motion, deceleration: float, t: float) -> Motion:
    """Motion from the state of `motion` at t s to rest, with a deceleration in m/s²."""
    return change_speed(motion, np.zeros(6), deceleration, t)

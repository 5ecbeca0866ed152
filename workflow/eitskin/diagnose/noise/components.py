"""The errors that every rig has and no diagnosis names: one class each.

A class states how large its error is on an ordinary bench, what it acts on and what it does to the
readings (its basis). Registered by `component` it is part of the covariance (`rig_errors`), its
standard deviation is learned (`component_sds`) and reported. Its sentence stands in
`verdict/rig_words.py`, its unit in the test of that. The form follows PINT's noise components (Luo
et al., ApJ 911, 2021): basis and weights of a low-rank part of the covariance.
"""

from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np

from eitskin.diagnose.noise.linearisation import Linearisation

READINGS = "readings"  # the unit of a component in that of the recording
FAST_WAVES = 12  # cosine waves of what a gain does: the rest hold 1.6 % of a random walk
SLOW_WAVES = 6  # of a channel's drift or of a force's zero, which are slower: 3.1 %
LEAST_FRAMES = 6  # fewer hardly show a scatter: its logarithm would be uncertain by a third
LEAST_PRESSES = 3  # likewise; two scatter about their mean by one degree of freedom
LEAST_SLIDE_MM = 1.0  # between the mean places of a press's halves: less is a touch that stays
# Quadrature adds its square, whose tail is exponential: channels are compared under a normal error
# that is as many times as wide.
QUADRATURE_TAIL = 2.5
CONVERTER_BINS = 32  # parts of a converter's step: finer than noise that would blur the steps


class NoiseComponent(ABC):
    """Independent errors of one sd, to which the readings respond in proportion.

    name: in diagnosis.json. unit: of the sd; READINGS: that of the recording. prior_sd: of the
    half-normal prior of the sd, in its unit or in median readings. acts_on: what each has an error
    of its own, "frame", "press", "channel" or the "whole" recording. least_frames: in fewer of the
    `affected_frames` the error does not show, and is left out. least_presses: with fewer the sd
    cannot be learned, and is assumed to be the prior's. lasting: one value a channel that stays the
    same. common_mode: moves all readings of a frame together. discrepancy: stands for physics
    without a name, no error of a rig; it never enters the chi squared of a verdict.
    every_frame: the component that moves readings alike, independently from frame to frame; "" for
    none. alike: which of the K errors, if all that it acts on have it alike, a calibration or an
    effect can do as well; their size tells nothing of the sd. largest: times the prior's sd, that
    the sd may be: more is no ordinary rig. in_covariance: whether fits reckon with it.
    has_common_part: whether its mean over all presses is a number of its own that is reported.
    occasional: whether its sd is learned only where the other components leave something to it.
    """

    name: ClassVar[str]
    unit: ClassVar[str]
    prior_sd: ClassVar[float]
    acts_on: ClassVar[str]
    least_frames: ClassVar[int] = 0
    least_presses: ClassVar[int] = 0
    lasting: ClassVar[bool] = False
    common_mode: ClassVar[bool] = False
    discrepancy: ClassVar[bool] = False
    every_frame: ClassVar[str] = ""
    alike: ClassVar[slice] = slice(0)
    largest: ClassVar[float] = 3.0
    in_covariance: ClassVar[bool] = True
    has_common_part: ClassVar[bool] = False
    occasional: ClassVar[bool] = False

    def affected_frames(self, linearisation: Linearisation) -> np.ndarray:
        """(N,) bool: frames that the error acts on; all."""
        return np.ones(len(linearisation.voltage), bool)

    def is_present(self, linearisation: Linearisation) -> bool:
        """Whether a recording can have the error and shows it: in `least_frames`."""
        return bool(self.affected_frames(linearisation).sum() >= self.least_frames)

    def is_identifiable(self, linearisation: Linearisation) -> bool:
        """Whether the sd can be learned; otherwise it is assumed to be the prior's."""
        return linearisation.press_count >= self.least_presses

    @abstractmethod
    def basis(self, linearisation: Linearisation) -> np.ndarray:
        """(K, N, M): what one unit of each of K independent errors does to the readings."""

    def weights(self, error_sd: float, fitted: bool) -> dict[str, float]:
        """Sd of the basis' coefficients, by what the errors act on. fitted: in the covariance of
        fits, where lasting errors are "linked": followed into other channels."""
        return {"linked" if fitted and self.lasting else self.acts_on: error_sd}

    def reported_sd(self, error_sd: float) -> float:
        """The sd as a reader is told it."""
        return error_sd

    @property
    def in_readings(self) -> bool:
        """Whether the sd is in the unit of the readings."""
        return self.unit == READINGS

    def prior_in_unit(self, typical_reading: float) -> float:
        """Sd of the prior in the unit of the sd; typical_reading: median |v|."""
        return self.prior_sd * (typical_reading if self.in_readings else 1.0)


class TouchComponent(NoiseComponent):
    """An error of the stated place or force of touches, from frame to frame."""

    acts_on = "frame"
    least_frames = LEAST_FRAMES

    @abstractmethod
    def displacements(self, linearisation: Linearisation) -> list[dict[str, np.ndarray]]:
        """By how much one unit of each of K errors displaces the touches (N,), by column of the
        states."""

    def affected_frames(self, linearisation: Linearisation) -> np.ndarray:
        """(N,) bool: touched frames."""
        return linearisation.touched

    def is_present(self, linearisation: Linearisation) -> bool:
        """Whether touches show the error, and the physics has derivatives by what it displaces."""
        columns = {column for error in self.displacements(linearisation) for column in error}
        return super().is_present(linearisation) and columns <= set(linearisation.derivatives)

    def basis(self, linearisation: Linearisation) -> np.ndarray:
        """(K, N, M): displacements times the derivatives of the readings."""
        errors = self.displacements(linearisation)
        basis = np.zeros((len(errors), *linearisation.voltage.shape))
        for response, error in zip(basis, errors, strict=True):
            for column, displacement in error.items():
                response += displacement[:, None] * linearisation.derivatives[column]
        return basis


class PressTouchComponent(TouchComponent):
    """An error that lasts for a press, or longer."""

    has_common_part = True
    acts_on = "press"
    least_frames = 1
    least_presses = LEAST_PRESSES
    alike = slice(None)

    def affected_frames(self, linearisation: Linearisation) -> np.ndarray:
        """(N,) bool: frames of presses."""
        return linearisation.press >= 0


COMPONENTS: dict[str, NoiseComponent] = {}  # by name, in the order of the covariance's columns


def component(kind: type[NoiseComponent]) -> type[NoiseComponent]:
    """Decorator: registers a class in COMPONENTS, by its name."""
    COMPONENTS[kind.name] = kind()
    return kind


# Priors: what is ordinary on the benches whose recordings this was developed with; a rig may have
# `largest` times as much.


@component
class AmplitudePerFrame(NoiseComponent):
    """The source's amplitude jitters."""

    name, unit, prior_sd, acts_on = "amplitude-per-frame", "1", 2e-3, "frame"
    common_mode = True
    every_frame = name

    def basis(self, linearisation: Linearisation) -> np.ndarray:
        """(1, N, M): the readings themselves."""
        return linearisation.voltage[None]


@component
class CommonNoise(NoiseComponent):
    """Noise that all channels of a frame share."""

    name, unit, prior_sd, acts_on = "common-noise", READINGS, 2e-3, "frame"
    common_mode = True
    every_frame = name

    def basis(self, linearisation: Linearisation) -> np.ndarray:
        """(1, N, M): ones."""
        return np.ones((1, *linearisation.voltage.shape))


@component
class GainWalk(NoiseComponent):
    """The gain of all channels walks; its sd is that at the end of a walk as long."""

    name, unit, prior_sd, acts_on = "gain-walk", "1", 1e-2, "whole"
    least_frames = LEAST_FRAMES
    common_mode = True
    alike = slice(1)  # the mean, which a conductivity is as well
    largest = 30.0  # a gel that dries in the session
    every_frame = AmplitudePerFrame.name

    def waves(self, elapsed: np.ndarray) -> np.ndarray:
        """(1 + FAST_WAVES, N): of a random walk, at elapsed shares (N,) of the recording."""
        return random_walk_waves(elapsed, FAST_WAVES)

    def basis(self, linearisation: Linearisation) -> np.ndarray:
        """(1 + FAST_WAVES, N, M): waves times the readings."""
        return self.waves(linearisation.elapsed)[:, :, None] * linearisation.voltage


@component
class GainFlicker(GainWalk):
    """The gain of all channels flickers, with power in proportion to 1/f."""

    name, prior_sd = "gain-flicker", 2e-3

    def waves(self, elapsed: np.ndarray) -> np.ndarray:
        """(1 + FAST_WAVES, N): of 1/f noise, at elapsed shares (N,) of the recording."""
        return flicker_waves(elapsed, FAST_WAVES)


@component
class ChannelDrift(NoiseComponent):
    """Each channel drifts by itself; its sd is that at the end of a walk as long."""

    name, unit, prior_sd, acts_on = "channel-drift", READINGS, 2e-3, "channel"
    least_frames = LEAST_FRAMES

    def basis(self, linearisation: Linearisation) -> np.ndarray:
        """(1 + SLOW_WAVES, N, M): waves of a random walk."""
        waves = random_walk_waves(linearisation.elapsed, SLOW_WAVES)
        return waves[:, :, None] * np.ones(linearisation.voltage.shape)


@component
class ChannelWander(NoiseComponent):
    """Each channel wanders by itself about its level, for as long as its noise is seen to last."""

    name, unit, prior_sd, acts_on = "channel-wander", READINGS, 2e-3, "channel"
    least_frames = LEAST_FRAMES

    def is_present(self, linearisation: Linearisation) -> bool:
        """Whether the noise has a slow part."""
        return bool(linearisation.wander) and super().is_present(linearisation)

    def basis(self, linearisation: Linearisation) -> np.ndarray:
        """(K, N, M): waves of the slow part, in proportion to the channels' noise."""
        waves = linearisation.wander.waves(linearisation.number)
        relative_sd = linearisation.noise_sd / np.median(linearisation.noise_sd)
        return waves[:, :, None] * np.broadcast_to(relative_sd, linearisation.voltage.shape)


@component
class Quadrature(NoiseComponent):
    """Magnitudes hold the part in quadrature as well: |v + i q v| is |v| (1 + q^2 / 2), by a q of
    every channel that is the same in all frames. The error is q^2 / 2; q itself is reported."""

    name, unit, prior_sd, acts_on = "quadrature", "1", 2e-3, "channel"
    lasting = True

    def is_present(self, linearisation: Linearisation) -> bool:
        """Whether readings are magnitudes, and no differences."""
        return linearisation.magnitude and not linearisation.difference

    def basis(self, linearisation: Linearisation) -> np.ndarray:
        """(1, N, M): the magnitudes."""
        return np.abs(linearisation.voltage)[None]

    def weights(self, error_sd: float, fitted: bool) -> dict[str, float]:
        """In fits QUADRATURE_TAIL times as wide, and with its mean, by which all readings are
        larger: sqrt(2) times less than its sd, for q^2 of a normal q."""
        if not fitted:
            return super().weights(error_sd, fitted)
        return {"linked": QUADRATURE_TAIL * error_sd, "whole": error_sd / np.sqrt(2.0)}

    def reported_sd(self, error_sd: float) -> float:
        """The sd of q: that of q^2 / 2 is q^2 over sqrt(2)."""
        return np.sqrt(np.sqrt(2.0) * error_sd)


@component
class StaticDiscrepancy(NoiseComponent):
    """Each channel differs from its simulation by a share of its own, the same in all frames."""

    name, unit, prior_sd, acts_on = "static-discrepancy", "1", 2e-2, "channel"
    lasting = True
    discrepancy = True
    largest = np.inf

    def is_present(self, linearisation: Linearisation) -> bool:
        """Whether readings are signed, and no differences."""
        return not linearisation.magnitude and not linearisation.difference

    def basis(self, linearisation: Linearisation) -> np.ndarray:
        """(1, N, M): the untouched level's size."""
        voltage = linearisation.voltage
        return np.broadcast_to(np.abs(linearisation.untouched_level), (1, *voltage.shape))


@component
class Quantisation(NoiseComponent):
    """A converter's steps are wider than the noise: its rounding does not scatter. Readings in one
    part of a step are off alike, wherever the steps begin: the mean error of rounding is periodic
    (Widrow, Kollar, Quantization Noise, 2008)."""

    name, unit, prior_sd, acts_on = "quantisation", READINGS, 1.0, "whole"

    def is_present(self, linearisation: Linearisation) -> bool:
        """Whether there are such steps, in readings that are no differences."""
        return bool(linearisation.converter_step) and not linearisation.difference

    def basis(self, linearisation: Linearisation) -> np.ndarray:
        """(CONVERTER_BINS, N, M): 1 where a reading is expected in that part of a step, else 0."""
        return converter_bins(linearisation.voltage, linearisation.converter_step)


@component
class TouchDiscrepancy(NoiseComponent):
    """Each channel responds to touches by a share of its own more or less than simulated."""

    name, unit, prior_sd, acts_on = "touch-discrepancy", "1", 0.2, "channel"
    least_frames = 1
    lasting = True
    discrepancy = True
    largest = np.inf

    def affected_frames(self, linearisation: Linearisation) -> np.ndarray:
        """(N,) bool: touched frames."""
        return linearisation.touched

    def basis(self, linearisation: Linearisation) -> np.ndarray:
        """(1, N, M): what touches change."""
        change = linearisation.voltage - linearisation.untouched_level
        return np.where(linearisation.touched[:, None], change, 0.0)[None]


@component
class PlacePerFrame(TouchComponent):
    """The robot's place scatters from frame to frame."""

    name, unit, prior_sd = "place-per-frame", "mm", 1.0
    every_frame = name

    def displacements(self, linearisation: Linearisation) -> list[dict[str, np.ndarray]]:
        """Of every touch, along x and along y."""
        return _of_places(linearisation.touched.astype(float))


@component
class ForcePerFrame(TouchComponent):
    """The load cell scatters from frame to frame."""

    name, unit, prior_sd = "force-per-frame", "N", 0.1
    every_frame = name

    def displacements(self, linearisation: Linearisation) -> list[dict[str, np.ndarray]]:
        """Of every touch's force."""
        return [{"force_N": linearisation.touched.astype(float)}]


@component
class PlacePerPress(PressTouchComponent, PlacePerFrame):
    """The robot's place is off, press by press."""

    name, unit, prior_sd = "place-per-press", "mm", 1.0
    every_frame = PlacePerFrame.name


@component
class ForcePerPress(PressTouchComponent):
    """The load cell's force is off by a share, press by press."""

    name, unit, prior_sd = "force-per-press", "1", 0.1
    every_frame = ForcePerFrame.name

    def displacements(self, linearisation: Linearisation) -> list[dict[str, np.ndarray]]:
        """Of every touch's force, in proportion to it."""
        return [{"force_N": _load(linearisation)}]


@component
class ForceZeroPerPress(PressTouchComponent, ForcePerFrame):
    """The load cell's zero is off, press by press."""

    name, unit, prior_sd = "force-zero-per-press", "N", 0.2
    every_frame = ForcePerFrame.name


class WalkingTouchComponent(PressTouchComponent):
    """An error that walks from press to press; its sd is that at the end of a walk as long."""

    acts_on = "whole"
    alike = slice(1)
    has_common_part = False  # its mean is that of the error of the presses

    def waves(self, linearisation: Linearisation) -> np.ndarray:
        """(1 + SLOW_WAVES, N): of a random walk, in touched frames."""
        return random_walk_waves(linearisation.elapsed, SLOW_WAVES) * linearisation.touched


@component
class PlaceWalk(WalkingTouchComponent):
    """The robot's place walks: arms warm up, belts slip."""

    name, unit, prior_sd = "place-walk", "mm", 1.0
    occasional = True
    every_frame = PlacePerFrame.name
    alike = slice(2)

    def displacements(self, linearisation: Linearisation) -> list[dict[str, np.ndarray]]:
        """Of every touch, along x and along y, by waves of a random walk."""
        return [error for wave in self.waves(linearisation) for error in _of_places(wave)]


@component
class ForceWalk(WalkingTouchComponent):
    """The load cell's factor walks."""

    name, unit, prior_sd = "force-walk", "1", 0.1
    occasional = True
    every_frame = ForcePerFrame.name

    def displacements(self, linearisation: Linearisation) -> list[dict[str, np.ndarray]]:
        """Of every touch's force, in proportion to it, by waves of a random walk."""
        return [{"force_N": wave * _load(linearisation)} for wave in self.waves(linearisation)]


@component
class ForceZeroWalk(WalkingTouchComponent):
    """The load cell's zero walks."""

    name, unit, prior_sd = "force-zero-walk", "N", 0.2
    every_frame = ForcePerFrame.name

    def displacements(self, linearisation: Linearisation) -> list[dict[str, np.ndarray]]:
        """Of every touch's force, by waves of a random walk."""
        return [{"force_N": wave} for wave in self.waves(linearisation)]


class CreepingTouchComponent(PressTouchComponent):
    """An error that grows from frame to frame of each press, from nothing; its sd is that at a
    press's last frame."""

    has_common_part = False
    occasional = True
    alike = slice(0)

    def is_present(self, linearisation: Linearisation) -> bool:
        """Whether presses last for frames enough."""
        count = linearisation.touched.sum() - linearisation.press_count
        return bool(count >= LEAST_FRAMES) and super().is_present(linearisation)


@component
class PlaceCreep(CreepingTouchComponent):
    """The probe creeps away under load."""

    name, unit, prior_sd = "place-creep", "mm", 1.0
    every_frame = PlacePerFrame.name

    def displacements(self, linearisation: Linearisation) -> list[dict[str, np.ndarray]]:
        """Of every touch, along x and along y."""
        return _of_places(linearisation.press_share)


@component
class ForceZeroCreep(CreepingTouchComponent):
    """The load cell creeps under load."""

    name, unit, prior_sd = "force-zero-creep", "N", 0.2
    every_frame = ForcePerFrame.name
    alike = slice(None)  # a gel that gives way

    def displacements(self, linearisation: Linearisation) -> list[dict[str, np.ndarray]]:
        """Of every touch's force."""
        return [{"force_N": linearisation.press_share}]


class DelayComponent(PressTouchComponent):
    """A state is reported that was there so long ago, in all presses."""

    unit, prior_sd, acts_on = "s", 0.1, "whole"

    def is_present(self, linearisation: Linearisation) -> bool:
        """Whether times were measured."""
        return linearisation.timed and super().is_present(linearisation)

    def is_identifiable(self, linearisation: Linearisation) -> bool:
        """Never: one number has no sd."""
        return False


@component
class PlaceDelay(DelayComponent):
    """The robot's pose is late, which shows where touches slide."""

    name = "place-delay"

    def is_present(self, linearisation: Linearisation) -> bool:
        """Whether some touch slides."""
        return linearisation.slide_mm >= LEAST_SLIDE_MM and super().is_present(linearisation)

    def displacements(self, linearisation: Linearisation) -> list[dict[str, np.ndarray]]:
        """Of every touch, by its velocity."""
        return [{column: linearisation.rate[column] for column in ("x_mm", "y_mm")}]


@component
class ForceDelay(DelayComponent):
    """The load cell is late. The effect force-lag is it: where that is not named, its size is
    reported."""

    name = "force-delay"
    in_covariance = False

    def displacements(self, linearisation: Linearisation) -> list[dict[str, np.ndarray]]:
        """Of every touch's force, by its rate."""
        return [{"force_N": linearisation.rate["force_N"]}]


def _of_places(displacement: np.ndarray) -> list[dict[str, np.ndarray]]:
    """Displacements (N,) along x and along y, an error each."""
    return [{"x_mm": displacement}, {"y_mm": displacement}]


def _load(linearisation: Linearisation) -> np.ndarray:
    """(N,): force on the skin, 0 where nobody touches."""
    return np.where(linearisation.touched, linearisation.force_N, 0.0)


def random_walk_waves(elapsed: np.ndarray, count: int) -> np.ndarray:
    """(1 + count, N): Karhunen-Loeve waves of a random walk, of sd 1 at its end if it begins at 0,
    at elapsed shares (N,) of its time: its mean, and cosines of the walk about its mean.

    Mean and cosines count as independent: where a rig was when it was calibrated, at the beginning,
    at the end or in between, a recording does not tell.
    """
    rate = np.pi * np.arange(1, count + 1)[:, None]
    mean = np.full((1, len(elapsed)), 1.0 / np.sqrt(3.0))
    return np.concatenate([mean, np.sqrt(2.0) * np.cos(rate * elapsed) / rate])


def flicker_waves(elapsed: np.ndarray, count: int) -> np.ndarray:
    """(1 + count, N): waves of noise with power in proportion to 1/f, of sd 1 about its mean, and
    the mean, which has the power of the longest wave."""
    number = np.arange(1, count + 1)[:, None]
    size = 1.0 / np.sqrt(number * (1.0 / number).sum())
    mean = np.full((1, len(elapsed)), float(size[0, 0]))
    return np.concatenate([mean, np.sqrt(2.0) * size * np.cos(np.pi * number * elapsed)])


def converter_bins(voltage: np.ndarray, step: float) -> np.ndarray:
    """(CONVERTER_BINS, N, M): 1 where a reading (N, M) is in that part of a converter's step."""
    part = np.floor(voltage / step * CONVERTER_BINS) % CONVERTER_BINS
    return (part == np.arange(CONVERTER_BINS)[:, None, None]).astype(float)

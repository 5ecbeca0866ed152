"""What each frame says: a touch with its state, no touch, or that it cannot be told."""

from dataclasses import dataclass, field

import numpy as np

from eitskin.errors import InputError
from eitskin.exported.channels import Missing
from eitskin.exported.electrodes import Electrodes, channels_using
from eitskin.exported.predictor import Estimate, Predictor
from eitskin.stream import opening
from eitskin.stream.baseline import MAX_DRIFT_PER_S, OPENING_FRAMES, Baseline

TOUCH, NO_TOUCH, CANNOT_TELL, STARTING = "touch", "no touch", "cannot tell", "starting"
MAX_LOST_ELECTRODES = 2  # with more, too few channels are left to locate a touch
MAX_REJECTED_READINGS = 4  # outliers in one frame; more are no single spikes
MAX_MISSING_SHARE = 0.15  # of all channels; beyond, what is imputed outweighs what was read
LOST_AFTER_FRAMES = 3  # in a row: a spike lasts for one
RECOVERED_AFTER_FRAMES = 10  # consistent ones, of those that could contradict the electrode
UNFAMILIAR = "unlike what the model was trained on"


@dataclass(frozen=True)
class Verdict:
    """What one frame says.

    `kind` is one of TOUCH, NO_TOUCH, CANNOT_TELL, STARTING; `estimate` the state of a touch;
    `n_missing` the number of missing readings beside those of `lost_electrodes`; `reason` why
    nothing can be told; `notices` what has changed with this frame, for a person.
    """

    kind: str
    estimate: Estimate | None = None
    lost_electrodes: tuple[int, ...] = ()
    n_missing: int = 0
    reason: str = ""
    notices: tuple[str, ...] = ()


@dataclass
class Judge:
    """Judges the frames of a predictor's channels one after the other.

    The first `n_opening_frames` readings (M,) must be of an untouched skin; with `is_difference`
    readings are changes already, and there are no opening frames.
    """

    predictor: Predictor
    is_difference: bool = False
    n_opening_frames: int = OPENING_FRAMES
    lost_electrodes: tuple[int, ...] = field(default=(), init=False)
    _opening_frames: list[np.ndarray] = field(default_factory=list, init=False)
    _suspect_streak: tuple[int, int] = field(default=(-1, 0), init=False)
    _consistent_frames: dict[int, int] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        self.channel_table = np.array(self.predictor.header["dataset"]["channels"])
        self._electrodes = Electrodes(self.predictor.channels, self.channel_table)
        self._rejection_limits = self.predictor.header["lost"]
        self._baseline: Baseline | None = None
        self._lost_channels: np.ndarray = np.zeros(len(self.channel_table), dtype=bool)
        # the gate is of changes against a long mean; the opening's own noise comes on top
        self._noise_factor = (
            1.0 if self.is_difference else float(np.sqrt(1.0 + 1.0 / self.n_opening_frames))
        )

    def __call__(
        self, reading: np.ndarray, time_s: float, saturated: np.ndarray | None = None
    ) -> Verdict:
        """The verdict of one frame.

        `reading` (M,) is NaN where it was lost; `saturated` (M,) bool marks readings at the
        converter's limit. Raises InputError after the opening frames where the skin was touched or
        more than MAX_LOST_ELECTRODES electrodes are dead.
        """
        if saturated is not None and saturated.any():
            reading = np.where(saturated, np.nan, reading)
        if self._baseline is None and not self.is_difference:
            return self._take_opening_frame(reading, time_s)
        change = reading.copy() if self._baseline is None else self._baseline.change(reading)
        n_missing = int((np.isnan(reading) & ~self._lost_channels).sum())
        if n_missing > MAX_MISSING_SHARE * len(reading):
            fault = "saturated or lost" if saturated is not None else "lost"
            reason = f"{n_missing} of {len(reading)} readings are {fault}"
            return Verdict(CANNOT_TELL, None, self.lost_electrodes, n_missing, reason)
        gain_change = drift_gain = 0.0
        if self._baseline is not None:
            gain_change = self._baseline.common_gain(np.where(self._lost_channels, np.nan, change))
            drift_gain = self._baseline.drift_gain(gain_change, time_s)
            change = (change - drift_gain * self._baseline.level) / (1.0 + drift_gain)
        notices = self._recover_electrodes(change)
        change[self._lost_channels] = np.nan
        verdict = self._judge_change(change, gain_change - drift_gain, notices)
        if self._baseline is not None and verdict.kind in (TOUCH, NO_TOUCH):
            self._baseline.accept_gain(drift_gain, time_s)
            if verdict.kind == NO_TOUCH:
                self._baseline.learn(np.where(self._lost_channels, np.nan, reading))
        return verdict

    def _take_opening_frame(self, reading: np.ndarray, time_s: float) -> Verdict:
        """Collect an opening frame; the last sets the baseline and the dead electrodes."""
        self._opening_frames.append(reading)
        if len(self._opening_frames) < self.n_opening_frames:
            return Verdict(STARTING, reason="leave the skin untouched")
        opening_frames = np.array(self._opening_frames)
        dead_electrodes = opening.find_dead_electrodes(opening_frames, self.channel_table)
        if len(dead_electrodes) > MAX_LOST_ELECTRODES:
            expected = f"{MAX_LOST_ELECTRODES} at most: too little is left to estimate from"
            raise InputError(
                "recording", "electrodes", f"{_electrode_list(dead_electrodes)} dead", expected
            )
        notices = tuple(
            f"electrode {k} is dead from the start; it is not used until a new one"
            for k in dead_electrodes
        )
        self.set_lost_electrodes(dead_electrodes)
        opening_frames[:, self._lost_channels] = np.nan
        opening.check(opening_frames, self.predictor)
        predictor = self.predictor
        self._baseline = Baseline(opening_frames, time_s, predictor.channels, predictor.scale)
        return Verdict(NO_TOUCH, lost_electrodes=self.lost_electrodes, notices=notices)

    def _judge_change(
        self, change: np.ndarray, excess_gain: float, notices: tuple[str, ...]
    ) -> Verdict:
        """The verdict of a change (M,); `excess_gain`: its common gain beyond a possible drift."""
        predictor, n_missing = self.predictor, self._count_missing(change)
        activity = predictor.activity(change)
        if self._is_untouched_activity(activity):
            self._suspect_streak = -1, 0
            return Verdict(
                NO_TOUCH, lost_electrodes=self.lost_electrodes, n_missing=n_missing, notices=notices
            )
        if self._baseline is not None and self._is_untouched(
            change - excess_gain * self._baseline.level
        ):
            self._suspect_streak = -1, 0
            reason = f"all readings moved by {100 * excess_gain:+.1f} %, more than a drift of"
            reason += f" {6000 * MAX_DRIFT_PER_S:g} % a minute can"
            return Verdict(CANNOT_TELL, None, self.lost_electrodes, n_missing, reason, notices)
        imputation = predictor.filled(change)
        if predictor.familiar(imputation[0]):
            self._suspect_streak = -1, 0
            return self._touch_verdict(change, activity, imputation, self.lost_electrodes, notices)
        cleaned, silent_electrode = self._without_outliers(change)
        if cleaned is None:
            estimate = predictor.estimate(*imputation, self.lost_electrodes)
            return Verdict(
                CANNOT_TELL, estimate, self.lost_electrodes, n_missing, UNFAMILIAR, notices
            )
        if silent_electrode is not None:
            notices += self._count_suspect(silent_electrode)
        else:
            self._suspect_streak = -1, 0
        activity = predictor.activity(cleaned)
        if self._is_untouched_activity(activity):
            return Verdict(
                NO_TOUCH, None, self.lost_electrodes, self._count_missing(cleaned), "", notices
            )
        lost_electrodes = (
            self.lost_electrodes
            if silent_electrode is None
            else tuple(sorted({*self.lost_electrodes, silent_electrode}))
        )
        return self._touch_verdict(
            cleaned, activity, predictor.filled(cleaned), lost_electrodes, notices
        )

    def _touch_verdict(
        self,
        change: np.ndarray,
        activity: float,
        imputation: tuple[np.ndarray, Missing],
        lost_electrodes: tuple[int, ...],
        notices: tuple[str, ...],
    ) -> Verdict:
        """The verdict of a change that looks like a touch: TOUCH within the range trained on."""
        estimate, reason = self.predictor.estimate(*imputation, lost_electrodes), ""
        if activity < self.predictor.weakest:
            reason = "weaker than what was trained on, or the untouched frame has moved"
        elif exceedance := self.predictor.out_of_range(estimate):
            reason = f"stronger, weaker or farther out than what was trained on: {exceedance}"
        kind = CANNOT_TELL if reason else TOUCH
        return Verdict(
            kind, estimate, self.lost_electrodes, self._count_missing(change), reason, notices
        )

    def _count_missing(self, change: np.ndarray) -> int:
        return int((np.isnan(change) & ~self._lost_channels).sum())

    def _is_untouched(self, change: np.ndarray) -> bool:
        """Whether a change is no larger than an untouched frame's."""
        return self._is_untouched_activity(self.predictor.activity(change))

    def _is_untouched_activity(self, activity: float) -> bool:
        """Whether an untouched frame's change may be of such a size."""
        return not self.predictor.exceeds(activity, self._noise_factor)

    def _without_outliers(self, change: np.ndarray) -> tuple[np.ndarray | None, int | None]:
        """The change with its outliers set to NaN, and the electrode that causes them, if one does.

        Up to MAX_REJECTED_READINGS single readings are rejected, else all of one electrode; (None,
        None) where neither makes the change plausible.
        """
        cleaned = change.copy()
        for _ in range(MAX_REJECTED_READINGS):
            z, strength_class = self._scaled_imputation(cleaned)
            deviations = self._electrodes.channel_distances(
                self._electrodes.precision_weighted(z, strength_class), strength_class
            )
            worst_channel = int(deviations.argmax())
            if deviations[worst_channel] <= self._rejection_limits["single"][strength_class]:
                break
            cleaned[worst_channel] = np.nan
            if self._is_plausible(cleaned):
                return cleaned, None
        if len(self.lost_electrodes) < MAX_LOST_ELECTRODES:
            z, strength_class = self._scaled_imputation(change)
            missing_channels = tuple(np.flatnonzero(np.isnan(change)).tolist())
            electrode_shares = self._electrodes.electrode_distances(
                self._electrodes.precision_weighted(z, strength_class),
                strength_class,
                missing_channels,
            )
            for electrode in np.argsort(-electrode_shares)[:2].tolist():
                cleaned = change.copy()
                cleaned[self._electrodes.groups[electrode]] = np.nan
                if electrode_shares[electrode] > self._rejection_limits["electrode"][
                    strength_class
                ] and self._is_plausible(cleaned):
                    return cleaned, electrode
        return None, None

    def _scaled_imputation(self, change: np.ndarray) -> tuple[np.ndarray, int]:
        """The change (M,) in units of the channels' scale, NaN imputed, and its strength class."""
        imputed, missing = self.predictor.filled(change)
        return imputed / self.predictor.scale, missing.class_number

    def _is_plausible(self, change: np.ndarray) -> bool:
        """Whether a change is an untouched frame's or a familiar touch's."""
        return self._is_untouched(change) or self.predictor.familiar(
            self.predictor.filled(change)[0]
        )

    def _count_suspect(self, electrode: int) -> tuple[str, ...]:
        """Count a frame that only this electrode spoils; notices of its loss."""
        previous, count = self._suspect_streak
        count = count + 1 if previous == electrode else 1
        self._suspect_streak = electrode, count
        if count < LOST_AFTER_FRAMES:
            return ()
        self.set_lost_electrodes([*self.lost_electrodes, electrode])
        self._suspect_streak = -1, 0
        return (f"electrode {electrode} is lost; estimates are made without it",)

    def set_lost_electrodes(self, electrodes: list[int]) -> None:
        """Do without the channels of exactly these electrodes from the next frame on."""
        self.lost_electrodes = tuple(sorted(electrodes))
        self._lost_channels = channels_using(self.channel_table, self.lost_electrodes)
        self._consistent_frames = dict.fromkeys(self.lost_electrodes, 0)

    def _recover_electrodes(self, change: np.ndarray) -> tuple[str, ...]:
        """Use electrodes again that agreed with the others for RECOVERED_AFTER_FRAMES frames.

        Only frames count in which the electrode's unchanged readings would be implausible: on an
        untouched skin a dead electrode reads the same as a working one. Returns notices.
        """
        recovered_electrodes = []
        for electrode in self.lost_electrodes:
            electrode_channels = self._electrodes.groups[electrode]
            if not np.isfinite(change[electrode_channels]).all():
                self._consistent_frames[electrode] = 0
                continue
            muted_change = self.predictor.filled(np.where(self._lost_channels, np.nan, change))[0]
            muted_change[electrode_channels] = 0.0
            if self._is_plausible(muted_change):
                continue
            other_lost_channels = channels_using(
                self.channel_table, [k for k in self.lost_electrodes if k != electrode]
            )
            is_consistent = self._is_plausible(np.where(other_lost_channels, np.nan, change))
            self._consistent_frames[electrode] = (
                self._consistent_frames[electrode] + 1 if is_consistent else 0
            )
            if self._consistent_frames[electrode] >= RECOVERED_AFTER_FRAMES:
                recovered_electrodes.append(electrode)
        if recovered_electrodes:
            self.set_lost_electrodes(
                [k for k in self.lost_electrodes if k not in recovered_electrodes]
            )
        return tuple(f"electrode {electrode} is back" for electrode in recovered_electrodes)


def _electrode_list(electrodes: list[int]) -> str:
    return f"electrodes {', '.join(map(str, electrodes))}"

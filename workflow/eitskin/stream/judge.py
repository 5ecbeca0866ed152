"""What each frame says: a touch with its state, no touch, or that it cannot be told."""

from dataclasses import dataclass, field

import numpy as np

from eitskin.errors import InputError
from eitskin.exported.channels import Missing
from eitskin.exported.electrodes import Electrodes, channels_using
from eitskin.exported.predictor import Estimate, Predictor
from eitskin.stream import opening
from eitskin.stream.untouched import OPENING, PER_S, Untouched

TOUCH, NO_TOUCH, CANNOT_TELL, STARTING = "touch", "no touch", "cannot tell", "starting"
MOST_LOST = 2  # electrodes
MOST_SINGLE = 4  # readings that are left out because the others say something else
MOST_SATURATED = 0.15  # of all channels
LOST_AFTER, BACK_AFTER = 3, 10  # frames in a row; of BACK_AFTER those that say something of it
UNLIKE = "unlike what the model was trained on"


@dataclass(frozen=True)
class Verdict:
    """kind: one of TOUCH, NO_TOUCH, CANNOT_TELL, STARTING; estimate: of a touch; lost: electrodes;
    left_out: readings that the estimate does without beside those of lost electrodes; why: what
    stands in the way; news: what has just changed."""

    kind: str
    estimate: Estimate | None = None
    lost: tuple[int, ...] = ()
    left_out: int = 0
    why: str = ""
    news: tuple[str, ...] = ()


@dataclass
class Judge:
    """Judges readings (M,) of a predictor's channels one after the other, those first that nobody
    touches; `difference`: they are changes already, and there is no untouched frame."""

    predictor: Predictor
    difference: bool = False
    opening: int = OPENING
    lost: tuple[int, ...] = field(default=(), init=False)
    _first: list[np.ndarray] = field(default_factory=list, init=False)
    _suspected: tuple[int, int] = field(default=(-1, 0), init=False)
    _agreed: dict[int, int] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        self.table = np.array(self.predictor.header["dataset"]["channels"])
        self._electrodes = Electrodes(self.predictor.channels, self.table)
        self._limits = self.predictor.header["lost"]
        self._untouched: Untouched | None = None
        self._gone: np.ndarray = np.zeros(len(self.table), dtype=bool)
        # the gate is of changes against a long mean; the opening's own noise comes on top
        self._noise = 1.0 if self.difference else float(np.sqrt(1.0 + 1.0 / self.opening))

    def __call__(
        self, reading: np.ndarray, time_s: float, saturated: np.ndarray | None = None
    ) -> Verdict:
        """The verdict of one frame; NaN where a reading was lost, saturated (M,) bool: readings
        that say only that they are too large.

        Raises InputError after the opening frames, where they are not of an untouched skin or more
        than MOST_LOST electrodes are dead.
        """
        if saturated is not None and saturated.any():
            reading = np.where(saturated, np.nan, reading)
        if self._untouched is None and not self.difference:
            return self._open(reading, time_s)
        change = reading.copy() if self._untouched is None else self._untouched.change(reading)
        left_out = int((np.isnan(reading) & ~self._gone).sum())
        if left_out > MOST_SATURATED * len(reading):
            what = "saturated or lost" if saturated is not None else "lost"
            why = f"{left_out} of {len(reading)} readings are {what}"
            return Verdict(CANNOT_TELL, None, self.lost, left_out, why)
        moved = drift = 0.0
        if self._untouched is not None:
            moved = self._untouched.moved(np.where(self._gone, np.nan, change))
            drift = self._untouched.allowed(moved, time_s)
            change = (change - drift * self._untouched.level) / (1.0 + drift)
        news = self._returned(change)
        change[self._gone] = np.nan
        verdict = self._judged(change, moved - drift, news)
        if self._untouched is not None and verdict.kind in (TOUCH, NO_TOUCH):
            self._untouched.known(drift, time_s)
            if verdict.kind == NO_TOUCH:
                self._untouched.learn(np.where(self._gone, np.nan, reading))
        return verdict

    def _open(self, reading: np.ndarray, time_s: float) -> Verdict:
        """The opening frames: their level, and the electrodes that are dead already."""
        self._first.append(reading)
        if len(self._first) < self.opening:
            return Verdict(STARTING, why="leave the skin untouched")
        frames = np.array(self._first)
        dead = opening.dead(frames, self.table)
        if len(dead) > MOST_LOST:
            expected = f"{MOST_LOST} at most: too little is left to estimate from"
            raise InputError("recording", "electrodes", f"{_words(dead)} dead", expected)
        news = tuple(
            f"electrode {k} is dead from the start; it is not used until a new one" for k in dead
        )
        self.lose(dead)
        frames[:, self._gone] = np.nan
        opening.check(frames, self.predictor)
        predictor = self.predictor
        self._untouched = Untouched(frames, time_s, predictor.channels, predictor.scale)
        return Verdict(NO_TOUCH, lost=self.lost, news=news)

    def _judged(self, change: np.ndarray, gain: float, news: tuple[str, ...]) -> Verdict:
        """gain: what moved all readings together beyond what a drift does meanwhile."""
        predictor, left_out = self.predictor, self._left_out(change)
        size = predictor.activity(change)
        if self._at_rest(size):
            self._suspected = -1, 0
            return Verdict(NO_TOUCH, lost=self.lost, left_out=left_out, news=news)
        if self._untouched is not None and self._still(change - gain * self._untouched.level):
            self._suspected = -1, 0
            why = f"all readings moved by {100 * gain:+.1f} %, more than a drift of"
            why += f" {6000 * PER_S:g} % a minute can"
            return Verdict(CANNOT_TELL, None, self.lost, left_out, why, news)
        filled = predictor.filled(change)
        if predictor.familiar(filled[0]):
            self._suspected = -1, 0
            return self._touch(change, size, filled, self.lost, news)
        rest, electrode = self._explained(change)
        if rest is None:
            found = predictor.estimate(*filled, self.lost)
            return Verdict(CANNOT_TELL, found, self.lost, left_out, UNLIKE, news)
        if electrode is not None:
            news += self._suspect(electrode)
        else:
            self._suspected = -1, 0
        size = predictor.activity(rest)
        if self._at_rest(size):
            return Verdict(NO_TOUCH, None, self.lost, self._left_out(rest), "", news)
        lost = self.lost if electrode is None else tuple(sorted({*self.lost, electrode}))
        return self._touch(rest, size, predictor.filled(rest), lost, news)

    def _touch(
        self,
        change: np.ndarray,
        size: float,
        filled: tuple[np.ndarray, Missing],
        lost: tuple[int, ...],
        news: tuple[str, ...],
    ) -> Verdict:
        """Of a change of such a size that looks like a touch: a touch, where it is among those
        trained on."""
        found, why = self.predictor.estimate(*filled, lost), ""
        if size < self.predictor.weakest:
            why = "weaker than what was trained on, or the untouched frame has moved"
        elif beyond := self.predictor.out_of_range(found):
            why = f"stronger, weaker or farther out than what was trained on: {beyond}"
        kind = CANNOT_TELL if why else TOUCH
        return Verdict(kind, found, self.lost, self._left_out(change), why, news)

    def _left_out(self, change: np.ndarray) -> int:
        return int((np.isnan(change) & ~self._gone).sum())

    def _still(self, change: np.ndarray) -> bool:
        """Whether a change is no larger than an untouched frame's."""
        return self._at_rest(self.predictor.activity(change))

    def _at_rest(self, size: float) -> bool:
        """Whether an untouched frame's change may be of such a size."""
        return not self.predictor.exceeds(size, self._noise)

    def _explained(self, change: np.ndarray) -> tuple[np.ndarray | None, int | None]:
        """A change without the few readings that make it strange, or without the electrode that
        does, and which; None where neither makes it familiar."""
        rest = change.copy()
        for _ in range(MOST_SINGLE):
            z, number = self._whole(rest)
            apart = self._electrodes.channel_distances(
                self._electrodes.precision_weighted(z, number), number
            )
            worst = int(apart.argmax())
            if apart[worst] <= self._limits["single"][number]:
                break
            rest[worst] = np.nan
            if self._fits(rest):
                return rest, None
        if len(self.lost) < MOST_LOST:
            z, number = self._whole(change)
            gone = tuple(np.flatnonzero(np.isnan(change)).tolist())
            shares = self._electrodes.electrode_distances(
                self._electrodes.precision_weighted(z, number), number, gone
            )
            for electrode in np.argsort(-shares)[:2].tolist():
                rest = change.copy()
                rest[self._electrodes.groups[electrode]] = np.nan
                if shares[electrode] > self._limits["electrode"][number] and self._fits(rest):
                    return rest, electrode
        return None, None

    def _whole(self, change: np.ndarray) -> tuple[np.ndarray, int]:
        whole, missing = self.predictor.filled(change)
        return whole / self.predictor.scale, missing.class_number

    def _fits(self, change: np.ndarray) -> bool:
        """Whether a change is an untouched frame's or a familiar touch's."""
        return self._still(change) or self.predictor.familiar(self.predictor.filled(change)[0])

    def _suspect(self, electrode: int) -> tuple[str, ...]:
        """One frame more in which all is well but for an electrode."""
        before, count = self._suspected
        count = count + 1 if before == electrode else 1
        self._suspected = electrode, count
        if count < LOST_AFTER:
            return ()
        self.lose([*self.lost, electrode])
        self._suspected = -1, 0
        return (f"electrode {electrode} is lost; estimates are made without it",)

    def lose(self, electrodes: list[int]) -> None:
        """From now on these electrodes are lost, and no others."""
        self.lost = tuple(sorted(electrodes))
        self._gone = channels_using(self.table, self.lost)
        self._agreed = dict.fromkeys(self.lost, 0)

    def _returned(self, change: np.ndarray) -> tuple[str, ...]:
        """Lost electrodes whose channels have said what the others say for BACK_AFTER frames.

        Only frames count in which an electrode that says nothing would not look like a touch: an
        untouched one that reads what it always reads may be dead as well.
        """
        back = []
        for electrode in self.lost:
            group = self._electrodes.groups[electrode]
            if not np.isfinite(change[group]).all():
                self._agreed[electrode] = 0
                continue
            mute = self.predictor.filled(np.where(self._gone, np.nan, change))[0]
            mute[group] = 0.0
            if self._fits(mute):
                continue
            others = channels_using(self.table, [k for k in self.lost if k != electrode])
            agrees = self._fits(np.where(others, np.nan, change))
            self._agreed[electrode] = self._agreed[electrode] + 1 if agrees else 0
            if self._agreed[electrode] >= BACK_AFTER:
                back.append(electrode)
        if back:
            self.lose([k for k in self.lost if k not in back])
        return tuple(f"electrode {electrode} is back" for electrode in back)


def _words(electrodes: list[int]) -> str:
    return f"electrodes {', '.join(map(str, electrodes))}"

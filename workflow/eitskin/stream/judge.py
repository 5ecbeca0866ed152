"""What each frame says: a touch with its state, no touch, or that it cannot be told."""

from dataclasses import dataclass, field

import numpy as np

from eitskin.errors import InputError
from eitskin.exported.electrodes import Electrodes
from eitskin.exported.predictor import Estimate, Predictor
from eitskin.stream import opening
from eitskin.stream.untouched import OPENING, Untouched

TOUCH, NO_TOUCH, CANNOT_TELL, STARTING = "touch", "no touch", "cannot tell", "starting"
MOST_LOST = 2  # electrodes
MOST_SINGLE = 4  # readings that are left out because the others say something else
MOST_SATURATED = 0.15  # of all channels
LOST_AFTER, BACK_AFTER = 3, 10  # frames in a row
LARGEST_DRIFT = 0.1  # a common gain by which the untouched frame may have moved meanwhile


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
    touches; `difference`: they are changes already, and there is no untouched frame to follow."""

    predictor: Predictor
    difference: bool = False
    opening: int = OPENING
    lost: tuple[int, ...] = ()
    _first: list[np.ndarray] = field(default_factory=list)
    _suspected: tuple[int, int] = (-1, 0)
    _agreed: dict[int, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.table = np.array(self.predictor.header["dataset"]["channels"])
        self._electrodes = Electrodes(self.predictor.channels, self.table)
        self._limits = self.predictor.header["lost"]
        self._untouched: Untouched | None = None
        self._gone: np.ndarray = np.zeros(len(self.table), dtype=bool)
        if self.difference:
            self._untouched = Untouched(np.zeros((1, len(self.table))))

    def __call__(self, reading: np.ndarray, saturated: np.ndarray | None = None) -> Verdict:
        """The verdict of one frame; NaN where a reading was lost, saturated (M,) bool: readings
        that say only that they are too large."""
        if saturated is not None and saturated.any():
            reading = np.where(saturated, np.nan, reading)
        if self._untouched is None:
            return self._open(reading)
        change = reading - self._untouched.level
        news = self._returned(change)
        change[self._gone] = np.nan
        left_out = int((np.isnan(change) & ~self._gone).sum())
        if left_out > MOST_SATURATED * len(change):
            what = "saturated or lost" if saturated is not None else "lost"
            why = f"{left_out} of {len(change)} readings are {what}"
            return Verdict(CANNOT_TELL, None, self.lost, left_out, why, news)
        return self._judged(reading, change, news)

    def _open(self, reading: np.ndarray) -> Verdict:
        """The opening frames: their level, and the electrodes that are dead already."""
        self._first.append(reading)
        if len(self._first) < self.opening:
            return Verdict(STARTING, why="leave the skin untouched")
        frames = np.array(self._first)
        self._untouched = Untouched(frames)
        dead = opening.dead(frames, self.table)
        if len(dead) > MOST_LOST:
            expected = f"{MOST_LOST} at most: too little is left to estimate from"
            raise InputError("stream", "electrodes", f"{_words(dead)} dead", expected)
        news = tuple(f"electrode {k} is dead from the start" for k in dead)
        self.lose(dead)
        return Verdict(NO_TOUCH, lost=self.lost, news=news)

    def _judged(self, reading: np.ndarray, change: np.ndarray, news: tuple[str, ...]) -> Verdict:
        predictor, left_out = self.predictor, int((np.isnan(change) & ~self._gone).sum())
        if self._still(change):
            self._suspected = -1, 0
            self._follow(reading, change)
            return Verdict(NO_TOUCH, lost=self.lost, left_out=left_out, news=news)
        filled = predictor.filled(change)
        if predictor.familiar(filled[0]):
            self._suspected = -1, 0
            found = predictor.estimate(*filled, self.lost)
            return Verdict(TOUCH, found, self.lost, left_out, "", news)
        rest, electrode = self._explained(change)
        if rest is None:
            why = "unlike what the model was trained on"
            found = predictor.estimate(*filled, self.lost)
            return Verdict(CANNOT_TELL, found, self.lost, left_out, why, news)
        if electrode is not None:
            news += self._suspect(electrode)
        else:
            self._suspected = -1, 0
        left_out = int((np.isnan(rest) & ~self._gone).sum())
        if self._still(rest):
            self._follow(reading, rest)
            return Verdict(NO_TOUCH, None, self.lost, left_out, "", news)
        lost = self.lost if electrode is None else tuple(sorted({*self.lost, electrode}))
        found = predictor.estimate(*predictor.filled(rest), lost)
        return Verdict(TOUCH, found, self.lost, left_out, "", news)

    def _still(self, change: np.ndarray) -> bool:
        """Whether nobody touches: the change is an untouched frame's, or such beside a common
        gain."""
        if not self.predictor.touched(change):
            return True
        if self.difference:
            return False
        assert self._untouched is not None
        rest, gain = self._untouched.without_gain(change, self.predictor.touch_scale)
        return abs(gain) < LARGEST_DRIFT and not self.predictor.touched(rest)

    def _follow(self, reading: np.ndarray, change: np.ndarray) -> None:
        if not self.difference:
            assert self._untouched is not None
            self._untouched.follow(np.where(np.isfinite(change), reading, np.nan))

    def _explained(self, change: np.ndarray) -> tuple[np.ndarray | None, int | None]:
        """A change without the few readings that make it strange, or without the electrode that
        does, and which; None where neither makes it familiar."""
        rest = change.copy()
        for _ in range(MOST_SINGLE):
            z, number = self._whole(rest)
            apart = self._electrodes.singles(self._electrodes.pull(z, number), number)
            worst = int(apart.argmax())
            if apart[worst] <= self._limits["single"][number]:
                break
            rest[worst] = np.nan
            if self._fits(rest):
                return rest, None
        if len(self.lost) < MOST_LOST:
            z, number = self._whole(change)
            gone = tuple(np.flatnonzero(np.isnan(change)).tolist())
            shares = self._electrodes.apart(self._electrodes.pull(z, number), number, gone)
            for electrode in np.argsort(-shares)[:2].tolist():
                rest = change.copy()
                rest[self._electrodes.groups[electrode]] = np.nan
                if shares[electrode] > self._limits["electrode"][number] and self._fits(rest):
                    return rest, electrode
        return None, None

    def _whole(self, change: np.ndarray) -> tuple[np.ndarray, int]:
        whole, missing = self.predictor.filled(change)
        return whole / self.predictor.scale, missing.number

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
        self._gone = np.asarray(np.isin(self.table, self.lost).any(axis=1))
        self._agreed = dict.fromkeys(self.lost, 0)

    def _returned(self, change: np.ndarray) -> tuple[str, ...]:
        """Lost electrodes whose channels have said what the others say for BACK_AFTER frames."""
        back = []
        for electrode in self.lost:
            with_it = change.copy()
            others = [k for k in self.lost if k != electrode]
            with_it[np.isin(self.table, others).any(axis=1)] = np.nan
            agrees = bool(np.isfinite(change[self._electrodes.groups[electrode]]).all())
            agrees = agrees and self._fits(with_it)
            self._agreed[electrode] = self._agreed[electrode] + 1 if agrees else 0
            if self._agreed[electrode] >= BACK_AFTER:
                back.append(electrode)
        if back:
            self.lose([k for k in self.lost if k not in back])
        return tuple(f"electrode {electrode} is back" for electrode in back)


def _words(electrodes: list[int]) -> str:
    return f"electrodes {', '.join(map(str, electrodes))}"

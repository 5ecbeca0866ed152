"""The next experiment: which further frames make two names distinguishable.

Every design is simulated with the fitted model and the estimated noise, and the gap between the two
names is that of `gaps` on the simulated frames. Gaps grow with the root of the number of frames in
any case: only a design that does better than more of the same is worth its trouble.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
import pandas as pd

from eitskin.data.recording import Recording
from eitskin.diagnose.fitting.fit import Problem, fit
from eitskin.diagnose.fitting.simulator import RecordingSimulator
from eitskin.diagnose.noise.whitening import Whitening
from eitskin.diagnose.search.gates import CLEARLY_DISTINCT, DISTINCT
from eitskin.diagnose.search.refits import explain
from eitskin.diagnose.search.search import Search
from eitskin.diagnose.verdict.diagnosis import Diagnosis
from eitskin.diagnose.verdict.gaps import CLOSE, gaps
from eitskin.effects import EFFECTS
from eitskin.effects.effect import Setting
from eitskin.errors import InputError
from eitskin.physics.geometry import Geometry
from eitskin.physics.skin import Skin
from eitskin.physics.solver import EffortExceeded, forward_model
from eitskin.quantities import listed, number

MOST_PRESSES = 8  # on which designs are compared, as each press costs solutions; the best see all
FINALISTS = 2  # of these designs, that are then simulated with every press and fitted ...
BUDGET_SHARE = 0.5  # of what a diagnosis may solve: with it spent nothing more is tried
FINALIST_SHARE = 0.5  # of the largest gap on those presses: designs below it are no finalists
REPEATS = 4  # of the recording: a gap twice as large, by the root of the number of frames
FORCE_FACTOR = 1.5  # a harder press that the rig of the recording still stands
HOLD_S, HOLD_STEP_S = 30.0, 10.0  # so that the relaxation of a gel shows, in three frames
STATES = ["time_s", "touch", "x_mm", "y_mm", "force_N", "probe_mm"]
NOTHING = "No experiment is needed to tell names apart."
AS_IS = "leave it at that"
REPEAT = f"repeat the recording until there are {REPEATS} of it"
TURN = "turn the connector by one electrode and record the same again"
DRIVE = "record again, the driven electrodes measured too"


def propose(diagnosis: Diagnosis) -> dict:
    """The experiment that splits the names which a diagnosis confuses, proved by simulation.

    {sentence, pairs: [{a, b, gap_now, gap_then, recipe}]}: a is a name of the diagnosis, b one of
    its alternatives or, where it has none, the nearest rival with a gap below CLEARLY_DISTINCT.
    Designs are compared on some of the presses; what is returned was simulated with all of them.
    What BUDGET_SHARE leaves no room for, as it may of bodies, is not tried.
    """
    pairs = list(_pairs(diagnosis))
    if not pairs:
        return {"sentence": NOTHING, "pairs": []}
    press = diagnosis.search.problem.model.press
    rows = np.arange(len(press))
    stride = -(-(press.max() + 1) // MOST_PRESSES)
    sampled_mask = np.where(press < 0, rows, press) % max(stride, 1) == 0
    designs = _designs(diagnosis, rows)
    is_complete = sampled_mask.all()
    sample = designs if is_complete else _designs(diagnosis, np.flatnonzero(sampled_mask))
    budget = Budget(BUDGET_SHARE * diagnosis.search.budget)
    splits = [_best_split(diagnosis, sample, designs, budget, pair) for pair in pairs]
    return {"sentence": _sentence(splits), "pairs": splits}


@dataclass
class Budget:
    """How many sheets may still be solved."""

    sheets: float


@dataclass(frozen=True)
class Pair:
    """Effect `index` of a diagnosis and the name of a rival, with the gap between them."""

    index: int
    rival: str
    gap: float


@dataclass(frozen=True)
class Design:
    """One experiment, set up.

    simulator: makes its simulator, anew for each use, as a simulator keeps what it solved;
    whitening: its covariance; frame_ratio: how many frames there are for one of the recording's.
    """

    simulator: Callable[[], RecordingSimulator]
    whitening: Whitening
    frame_ratio: float

    def gap(
        self,
        diagnosis: Diagnosis,
        budget: Budget,
        index: int,
        rival: str,
        within: float = np.inf,
    ) -> float | None:
        """Gap between effect `index` and a rival name in this experiment, within as of `gaps`;
        None: it cannot be computed, or not within the budget."""
        model = self.simulator()
        model.coarse = diagnosis.search.problem.model.coarse  # as for the gap of the recording
        if EFFECTS[rival].disc and isinstance(model, _TurnedConnector):
            return None  # its tangents have every channel where the board's table has it
        effects, theta = diagnosis.explanation.effects, diagnosis.explanation.fit.theta
        candidates = [c for c in diagnosis.search.candidates if c.name == rival]
        problem = Problem(model, np.zeros(1), self.whitening)
        try:
            with model.solved_skins.within(budget.sheets):
                problem = replace(problem, readings=model.voltage(*problem.split(theta, effects)))
                fold = np.zeros(len(problem.readings), int)
                seed, report = diagnosis.search.seed, lambda line: None
                search = Search(problem, candidates, fold, seed, report)
                explanation = explain(search, fit(problem, effects, theta))
                distances = gaps(search, explanation, index, within)
        except (InputError, np.linalg.LinAlgError, EffortExceeded):
            return None
        finally:
            budget.sheets -= model.solved_skins.effort
        return distances[0].gap if distances else None


def _pairs(diagnosis: Diagnosis) -> Iterator[Pair]:
    """What a diagnosis cannot distinguish, or hardly."""
    for index, distances in enumerate(diagnosis.gaps):
        confused = [rival for rival in distances if not DISTINCT.admits(rival.gap)]
        for rival in confused or [
            nearest for nearest in distances[:1] if not CLEARLY_DISTINCT.admits(nearest.gap)
        ]:
            yield Pair(index, rival.rival, rival.gap)


def _best_split(
    diagnosis: Diagnosis,
    sample: dict[str, Design],
    designs: dict[str, Design],
    budget: Budget,
    pair: Pair,
) -> dict:
    """The pair with the design that splits it best, of those that beat more of the same frame by
    frame; more of the same where none does. sample: the designs on some of the presses."""

    def beating(choice: dict[str, Design], gap_now: float, within: float) -> dict[str, float]:
        gap = {
            text: design.gap(diagnosis, budget, pair.index, pair.rival, within)
            for text, design in choice.items()
        }
        return {
            text: new_gap
            for text, design in choice.items()
            if (new_gap := gap[text]) is not None
            and new_gap > gap_now * np.sqrt(design.frame_ratio)
        }

    special = {text: design for text, design in sample.items() if text not in (AS_IS, REPEAT)}
    gap_now: float | None = pair.gap
    if sample is not designs:
        gap_now = sample[AS_IS].gap(diagnosis, budget, pair.index, pair.rival)
    new_gaps = beating(special, gap_now or 0.0, CLOSE * DISTINCT.threshold)
    required = FINALIST_SHARE * max(new_gaps.values(), default=0.0)
    rising = sorted(new_gaps, key=new_gaps.__getitem__)
    finalists = [text for text in rising if new_gaps[text] >= required][-FINALISTS:]
    new_gaps = beating({text: designs[text] for text in finalists}, pair.gap, np.inf)
    if not DISTINCT.admits(max(new_gaps.values(), default=0.0)):
        repeated = designs[REPEAT].gap(diagnosis, budget, pair.index, pair.rival)
        new_gaps[REPEAT] = pair.gap if repeated is None else repeated
    best = max(new_gaps, key=new_gaps.__getitem__)
    return {
        "a": diagnosis.explanation.effects[pair.index].name,
        "b": pair.rival,
        "gap_now": pair.gap,
        "gap_then": new_gaps[best],
        "recipe": best,
    }


def _sentence(splits: list[dict]) -> str:
    """What to do and what it would bring, the pairs that one design splits together."""
    parts, unsplit = [], []
    by_design: dict[str, list[str]] = {}
    for split in splits:
        gap_now, gap_then = number(split["gap_now"], 2), number(split["gap_then"], 2)
        names = f"{split['a']} from {split['b']}"
        if not DISTINCT.admits(split["gap_then"]):
            unsplit.append(f"{names} (gap {gap_now} now, {gap_then} at best)")
        else:
            text = f"{names} (gap {gap_now} now, {gap_then} then)"
            by_design.setdefault(split["recipe"], []).append(text)
    for design, texts in by_design.items():
        parts.append(f"{design[0].upper()}{design[1:]}: that would tell {listed(texts)}.")
    if unsplit:
        parts.append(f"Nothing tried would tell {listed(unsplit)}.")
    return " ".join(parts) or NOTHING


def _designs(diagnosis: Diagnosis, rows: np.ndarray) -> dict[str, Design]:
    """Everything that can be tried with the rig of a recording, by what to do; rows (N,): the
    frames that count as recorded."""
    problem, recording = diagnosis.search.problem, diagnosis.recording
    sequel = _Sequel(recording, problem.model, rows)
    repeat = sequel.repeated()
    repeats = pd.concat([sequel.repeated(1 + k) for k in range(REPEATS - 1)], ignore_index=True)
    designs = {}
    for text, frames in {AS_IS: repeat[:0], REPEAT: repeats, **sequel.presses()}.items():
        simulator = partial(RecordingSimulator, sequel.joined(frames), problem.model)
        designs[text] = sequel.design(simulator, problem.whitening, len(frames))
    turned = partial(_TurnedConnector, sequel, repeat)
    designs[TURN] = sequel.design(turned, problem.whitening, len(repeat))
    driven = _driven_design(diagnosis, sequel)
    if driven is not None:
        designs[DRIVE] = driven
    return designs


@dataclass(frozen=True)
class _Sequel:
    """What could be recorded after the end of a recording: its frames (N,) once more, as far as
    they can be simulated."""

    recording: Recording
    model: RecordingSimulator
    frames: np.ndarray

    @cached_property
    def rows(self) -> np.ndarray:
        """(K,) of the frames whose state is known."""
        return self.frames[self.model.simulable[self.frames]]

    @cached_property
    def waits_s(self) -> np.ndarray:
        """s from the previous frame, of all the recording's; to the first the median one."""
        steps = np.diff(self.recording.frames["time_s"].to_numpy(float))
        return np.r_[np.median(steps) if len(steps) else 1.0, steps]

    def repeated(self, times: int = 1) -> pd.DataFrame:
        """The frames once more, as the `times`-th repeat."""
        return self._timed(self.rows, self.waits_s[self.rows], times)

    def _timed(self, rows: np.ndarray, waits_s: np.ndarray, times: int = 1) -> pd.DataFrame:
        """Frames (K,) of the recording in a new order, each so long after the previous one."""
        time_s = self.recording.frames["time_s"].to_numpy(float)
        start = time_s[-1] + (times - 1) * self.waits_s[self.rows].sum()
        frames = self.recording.frames[STATES].iloc[rows].reset_index(drop=True)
        press = self.model.press[rows]
        contact = np.where(press < 0, np.nan, press + times * (self.model.press.max() + 1))
        return frames.assign(time_s=start + np.cumsum(waits_s), contact=contact)

    def query(self, frames: pd.DataFrame) -> Recording:
        """Frames without readings, of this recording's rig."""
        return Recording(frames, None, None, None, self.recording.metadata)

    def joined(self, frames: pd.DataFrame) -> Recording:
        """A query: the recording's frames, then new ones."""
        press = self.model.press
        contact = np.where(press < 0, np.nan, press)
        recorded_frames = self.recording.frames[STATES].assign(contact=contact)
        joined = pd.concat([recorded_frames.iloc[self.frames], frames], ignore_index=True)
        return self.query(joined)

    def design(
        self, simulator: Callable[[], RecordingSimulator], whitening: Whitening, new_frames: int
    ) -> Design:
        """A design with so many new frames; a channel that was always lost stays lost."""
        new_mask = np.tile(whitening.mask.any(axis=0), (new_frames, 1))
        mask = np.concatenate([whitening.mask[self.frames], new_mask])
        numbers = self.recording.frames["frame"].to_numpy()
        new_numbers = numbers[-1] + 1 + np.arange(new_frames)
        frame_number = np.concatenate([numbers[self.frames], new_numbers])
        whitening = replace(whitening, mask=mask, frame_number=frame_number)
        return Design(simulator, whitening, 1.0 + new_frames / len(self.frames))

    def presses(self) -> dict[str, pd.DataFrame]:
        """Other presses, by what to do."""
        touched = self.rows[self.model.touched[self.rows]]
        if not len(touched):
            return {}
        repeat = self.repeated()
        plans = {
            "press again at the same places with a probe half as wide": repeat.assign(
                probe_mm=0.5 * repeat["probe_mm"]
            ),
            "press again at the same places with a probe twice as wide": repeat.assign(
                probe_mm=2.0 * repeat["probe_mm"]
            ),
            "press at as many other places": self._elsewhere(repeat),
            f"press again with {FORCE_FACTOR:g} times the force": repeat.assign(
                force_N=FORCE_FACTOR * repeat["force_N"]
            ),
        }
        peaks = self._peaks()
        unloading = {rows[-1]: rows[:-1][::-1] for rows in peaks.values()}
        if any(map(len, unloading.values())):
            text = "press again, and read the same forces on the way back"
            plans[text] = self._inserted(unloading, None)
        if self.recording.metadata["clock"] == "measured":
            count = round(HOLD_S / HOLD_STEP_S)
            holding = {rows[-1]: np.full(count, rows[-1]) for rows in peaks.values()}
            text = (
                f"press again, and hold each press at its largest force for {HOLD_S:g} s,"
                f" with a frame every {HOLD_STEP_S:g} s"
            )
            plans[text] = self._inserted(holding, HOLD_STEP_S)
        return plans

    def _peaks(self) -> dict[int, np.ndarray]:
        """Of each press the frames up to its largest force."""
        force = self.recording.frames["force_N"].to_numpy(float)
        peaks = {}
        for press in np.unique(self.model.press[self.rows]):
            rows = self.rows[self.model.press[self.rows] == press]
            if press >= 0:
                peaks[press] = rows[: int(np.argmax(force[rows])) + 1]
        return peaks

    def _inserted(self, insertions: dict[int, np.ndarray], wait_s: float | None) -> pd.DataFrame:
        """The frames once more, further ones after some of them, each `wait_s` later or as
        usual."""
        rows, waits = [], []
        for row in self.rows:
            insertion = insertions.get(row, np.zeros(0, int))
            rows += [row, *insertion]
            wait = wait_s or np.median(self.waits_s)
            waits += [self.waits_s[row], *np.full(len(insertion), wait)]
        return self._timed(np.array(rows), np.array(waits))

    def _elsewhere(self, frames: pd.DataFrame) -> pd.DataFrame:
        """Frames whose touches are turned about the skin's middle, by a quarter of it and half an
        electrode."""
        place = frames["x_mm"].to_numpy() + 1j * frames["y_mm"].to_numpy()
        middle = 0.0
        if self.recording.metadata["position_frame"] == "robot":
            middle = np.nanmean(place)
        turn = np.exp(1j * (0.5 * np.pi + np.pi / self.recording.n_electrodes))
        place = middle + turn * (place - middle)
        return frames.assign(x_mm=place.real, y_mm=place.imag)


def _driven_design(diagnosis: Diagnosis, sequel: _Sequel) -> Design | None:
    """The frames again with every measuring pair in every drive, those on driven electrodes too;
    None where all are read, or where an effect stands at channels of the table as it is.

    The new frames count alone: those recorded, with another table, can only add to the gap. Noise
    and numerical error grow with the reading where it is larger than the median of those recorded.
    """
    recording, whitening = diagnosis.recording, diagnosis.search.problem.whitening
    effects = diagnosis.explanation.effects
    table = recording.channels
    drives, pairs = np.unique(table[:, :2], axis=0), np.unique(table[:, 2:], axis=0)
    full_table = np.array([(*drive, *pair) for drive in drives for pair in pairs])
    if len(full_table) <= len(table) or any(c.kind == "channels" for c in effects):
        return None
    repeat = sequel.repeated()
    metadata = recording.metadata | {"channels": full_table.tolist()}
    query = replace(sequel.query(repeat), metadata=metadata)
    simulator = partial(RecordingSimulator, query, sequel.model)
    model = sequel.model
    skin = model.skin(diagnosis.explanation.fit.theta[: len(model.calibrations)])
    forward = forward_model(Geometry.from_skin(skin), "diagnose")
    try:
        reading = np.abs(forward.voltages(full_table))
    except InputError:
        return None
    growth = np.maximum(reading / np.median(np.abs(forward.voltages(table))), 1.0)
    rho = np.full(len(full_table), np.median(whitening.offset_ratio))
    mask = np.ones((len(repeat), len(full_table)), bool)
    covariance = Whitening(mask, np.median(whitening.sd) * growth, rho)
    return Design(simulator, covariance, 1.0 + len(repeat) / len(sequel.frames))


class _RolledElectrodes(RecordingSimulator):
    """The board's electrodes, each on the place of the next."""

    def skin(self, coordinates: np.ndarray) -> Skin:
        """The skin, as the board counts its electrodes."""
        skin = super().skin(coordinates)
        assert skin.electrode_deg is not None
        xy_mm = skin.electrode_xy_mm
        return replace(
            skin,
            electrode_deg=tuple(np.roll(skin.electrode_deg, -1).tolist()),
            electrode_xy_mm=None if xy_mm is None else (*xy_mm[1:], xy_mm[0]),
        )


class _TurnedConnector(RecordingSimulator):
    """A recording's frames, and frames after the connector was turned by one electrode: what is on
    the skin has gone to another terminal, what is in the wiring and the instrument stays."""

    def __init__(self, sequel: _Sequel, frames: pd.DataFrame):
        super().__init__(sequel.joined(frames), sequel.model)
        recorded_frames = sequel.joined(frames[:0])
        self._recorded_part = RecordingSimulator(recorded_frames, sequel.model, self.solved_skins)
        self._turned_part = _RolledElectrodes(sequel.query(frames), sequel.model, self.solved_skins)

    def voltage(
        self, coordinates: np.ndarray, settings: list[Setting], accuracy: str | None = None
    ) -> np.ndarray:
        """(N, M) as of `RecordingSimulator`."""
        accuracy = accuracy or self.accuracy(coordinates, settings)
        assert self.nominal_skin.electrode_deg is not None
        n = len(self.nominal_skin.electrode_deg)
        turned_settings = [
            replace(s, sites=(s.sites - 1) % n)
            if s.effect.stage == "skin" and s.sites is not None
            else s
            for s in settings
        ]
        recorded_part = self._recorded_part.voltage(coordinates, settings, accuracy)
        turned_part = self._turned_part.voltage(coordinates, turned_settings, accuracy)
        return np.concatenate([recorded_part, turned_part])

"""The next experiment: which frames, recorded after those that are there, tell two names apart.

Every recipe is simulated with the fitted model and the noise estimated, and the gap between the two
names is that of `gaps` on the frames simulated. Gaps grow with the root of the number of frames in
any case: only a recipe that does better than more of the same is worth its trouble.
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

MOST_PRESSES = 8  # on which recipes are compared
MOST_TRIED = 2  # that are then simulated with every press and fitted ...
SHARE = 0.5  # of what a diagnosis may solve: with it spent nothing more is tried
WORTH = 0.5  # of the largest gap on those presses: recipes below it are not
REPEATS = 4
HARDER = 1.5  # times the forces
HOLD_S, LOOK_S = 30.0, 10.0  # of a force held, and between its frames
STATES = ["time_s", "touch", "x_mm", "y_mm", "force_N", "probe_mm"]
NOTHING = "No experiment is needed to tell names apart."
AS_IS = "leave it at that"
SAME = f"repeat the recording until there are {REPEATS} of it"
TURN = "turn the connector by one electrode and record the same again"
DRIVE = "record again, the driven electrodes measured too"


def propose(found: Diagnosis) -> dict:
    """The experiment that splits the names which a diagnosis confuses, proved by simulation.

    {sentence, pairs: [{a, b, gap_now, gap_then, recipe}]}: a is a name found, b one of its
    alternatives or, where it has none, the nearest rival with a gap below CLEARLY_DISTINCT. Recipes
    are compared on some of the presses; what is returned was simulated with all of them. What SHARE
    leaves no room for, as it may of bodies, is not tried.
    """
    pairs = list(_pairs(found))
    if not pairs:
        return {"sentence": NOTHING, "pairs": []}
    model = found.search.problem.model
    every = np.arange(len(model.press))
    stride = -(-(model.press.max() + 1) // MOST_PRESSES)
    some = np.where(model.press < 0, every, model.press) % max(stride, 1) == 0
    whole = _recipes(found, every)
    few = whole if some.all() else _recipes(found, np.flatnonzero(some))
    budget = Budget(SHARE * found.search.budget)
    told = [_best(found, few, whole, budget, *pair) for pair in pairs]
    return {"sentence": _sentence(told), "pairs": told}


@dataclass
class Budget:
    """Sheets that may still be solved."""

    left: float


@dataclass(frozen=True)
class Recipe:
    """One experiment, set up: what makes its simulator, anew for each use, as a simulator keeps
    what it solved; its covariance; more: how many frames there are for one of the recording's."""

    simulator: Callable[[], RecordingSimulator]
    whitening: Whitening
    more: float

    def gap(
        self, found: Diagnosis, budget: Budget, index: int, rival: str, within: float = np.inf
    ) -> float | None:
        """Gap between effect `index` and a rival name in this experiment, within as of `gaps`;
        None: not to be had, or not with what is left of the budget."""
        model = self.simulator()
        model.coarse = found.search.problem.model.coarse  # as what the gap now was found with
        if EFFECTS[rival].disc and isinstance(model, _Turned):
            return None  # its tangents have every channel where the board's table has it
        effects, theta = found.after.effects, found.after.fit.theta
        candidates = [c for c in found.search.candidates if c.name == rival]
        problem = Problem(model, np.zeros(1), self.whitening)
        try:
            with model.solved_skins.within(budget.left):
                problem = replace(problem, readings=model.voltage(*problem.split(theta, effects)))
                fold = np.zeros(len(problem.readings), int)
                seed, report = found.search.seed, lambda line: None
                search = Search(problem, candidates, fold, seed, report)
                state = explain(search, fit(problem, effects, theta))
                named = gaps(search, state, index, within)
        except (InputError, np.linalg.LinAlgError, EffortExceeded):
            return None
        finally:
            budget.left -= model.solved_skins.effort
        return named[0].gap if named else None


def _pairs(found: Diagnosis) -> Iterator[tuple[int, str, float]]:
    """Effect, rival and gap of what a diagnosis cannot tell apart, or hardly."""
    for index, named in enumerate(found.gaps):
        confused = [each for each in named if not DISTINCT.admits(each.gap)]
        for each in confused or [
            each for each in named[:1] if not CLEARLY_DISTINCT.admits(each.gap)
        ]:
            yield index, each.rival, each.gap


def _best(
    found: Diagnosis,
    few: dict[str, Recipe],
    whole: dict[str, Recipe],
    budget: Budget,
    index: int,
    rival: str,
    gap_now: float,
) -> dict:
    """The pair with the recipe that splits it best, of those that beat more of the same frame by
    frame; more of the same where none does."""
    pair = {"a": found.after.effects[index].name, "b": rival, "gap_now": gap_now}

    def beating(recipes: dict[str, Recipe], now: float, within: float) -> dict[str, float]:
        gap = {text: r.gap(found, budget, index, rival, within) for text, r in recipes.items()}
        return {
            text: own
            for text, recipe in recipes.items()
            if (own := gap[text]) is not None and own > now * np.sqrt(recipe.more)
        }

    special = {text: recipe for text, recipe in few.items() if text not in (AS_IS, SAME)}
    now = gap_now if few is whole else few[AS_IS].gap(found, budget, index, rival)
    tried = beating(special, now or 0.0, CLOSE * DISTINCT.threshold)
    worth = WORTH * max(tried.values(), default=0.0)
    rising = sorted(tried, key=tried.__getitem__)
    first = [text for text in rising if tried[text] >= worth][-MOST_TRIED:]
    tried = beating({text: whole[text] for text in first}, gap_now, np.inf)
    if not DISTINCT.admits(max(tried.values(), default=0.0)):
        same = whole[SAME].gap(found, budget, index, rival)
        tried[SAME] = gap_now if same is None else same
    best = max(tried, key=tried.__getitem__)
    return {**pair, "gap_then": tried[best], "recipe": best}


def _sentence(pairs: list[dict]) -> str:
    """What to do and what it would bring, the pairs that one recipe splits together."""
    parts, in_vain = [], []
    by_recipe: dict[str, list[str]] = {}
    for pair in pairs:
        now, then = number(pair["gap_now"], 2), number(pair["gap_then"], 2)
        names = f"{pair['a']} from {pair['b']}"
        if not DISTINCT.admits(pair["gap_then"]):
            in_vain.append(f"{names} (gap {now} now, {then} at best)")
        else:
            split = f"{names} (gap {now} now, {then} then)"
            by_recipe.setdefault(pair["recipe"], []).append(split)
    for recipe, splits in by_recipe.items():
        parts.append(f"{recipe[0].upper()}{recipe[1:]}: that would tell {listed(splits)}.")
    if in_vain:
        parts.append(f"Nothing tried would tell {listed(in_vain)}.")
    return " ".join(parts) or NOTHING


def _recipes(found: Diagnosis, rows: np.ndarray) -> dict[str, Recipe]:
    """Everything that can be tried with the rig of a recording, by what to do; rows (N,): the
    frames that count as recorded."""
    problem = found.search.problem
    run = _Run(found.recording, problem.model, rows)
    again = run.again()
    more = pd.concat([run.again(1 + k) for k in range(REPEATS - 1)], ignore_index=True)
    recipes = {}
    for text, frames in {AS_IS: again[:0], SAME: more, **run.presses()}.items():
        simulator = partial(RecordingSimulator, found.recording, run.joined(frames))
        recipes[text] = run.recipe(simulator, problem.whitening, len(frames))
    turned = partial(_Turned, found.recording, run, again)
    recipes[TURN] = run.recipe(turned, problem.whitening, len(again))
    driven = _driven(found, run)
    if driven is not None:
        recipes[DRIVE] = driven
    return recipes


@dataclass(frozen=True)
class _Run:
    """Frames (N,) of a recording, to be recorded anew after its end as far as they can be
    simulated."""

    recorded: Recording
    model: RecordingSimulator
    frames: np.ndarray

    @cached_property
    def rows(self) -> np.ndarray:
        """(K,) of the frames whose state is known."""
        return self.frames[self.model.simulable[self.frames]]

    @cached_property
    def waits_s(self) -> np.ndarray:
        """s from the frame before, of all the recording's; to the first the usual one."""
        steps = np.diff(self.recorded.frames["time_s"].to_numpy(float))
        return np.r_[np.median(steps) if len(steps) else 1.0, steps]

    def again(self, times: int = 1) -> pd.DataFrame:
        """The frames once more, as the `times`-th repeat."""
        return self._timed(self.rows, self.waits_s[self.rows], times)

    def _timed(self, rows: np.ndarray, waits_s: np.ndarray, times: int = 1) -> pd.DataFrame:
        """Frames (K,) of the recording in a new order, each so long after the one before."""
        time_s = self.recorded.frames["time_s"].to_numpy(float)
        start = time_s[-1] + (times - 1) * self.waits_s[self.rows].sum()
        frames = self.recorded.frames[STATES].iloc[rows].reset_index(drop=True)
        press = self.model.press[rows]
        contact = np.where(press < 0, np.nan, press + times * (self.model.press.max() + 1))
        return frames.assign(time_s=start + np.cumsum(waits_s), contact=contact)

    def query(self, frames: pd.DataFrame) -> Recording:
        """Frames without readings, of this recording's rig."""
        return Recording(frames, None, None, None, self.recorded.metadata)

    def joined(self, frames: pd.DataFrame) -> Recording:
        """A query: the recording's frames, then others."""
        press = self.model.press
        own = self.recorded.frames[STATES].assign(contact=np.where(press < 0, np.nan, press))
        return self.query(pd.concat([own.iloc[self.frames], frames], ignore_index=True))

    def recipe(
        self, simulator: Callable[[], RecordingSimulator], whitening: Whitening, new: int
    ) -> Recipe:
        """A recipe with so many new frames; a channel that was always lost stays lost."""
        more = np.tile(whitening.mask.any(axis=0), (new, 1))
        mask = np.concatenate([whitening.mask[self.frames], more])
        clock = self.recorded.frames["frame"].to_numpy()
        clock = np.concatenate([clock[self.frames], clock[-1] + 1 + np.arange(new)])
        whitening = replace(whitening, mask=mask, frame_number=clock)
        return Recipe(simulator, whitening, 1.0 + new / len(self.frames))

    def presses(self) -> dict[str, pd.DataFrame]:
        """Other presses, by what to do."""
        touched = self.rows[self.model.touched[self.rows]]
        if not len(touched):
            return {}
        again = self.again()
        plans = {
            "press again at the same places with a probe half as wide": again.assign(
                probe_mm=0.5 * again["probe_mm"]
            ),
            "press again at the same places with a probe twice as wide": again.assign(
                probe_mm=2.0 * again["probe_mm"]
            ),
            "press at as many other places": self._elsewhere(again),
            f"press again with {HARDER:g} times the force": again.assign(
                force_N=HARDER * again["force_N"]
            ),
        }
        peaks = self._peaks()
        back = {rows[-1]: rows[:-1][::-1] for rows in peaks.values()}
        if any(map(len, back.values())):
            text = "press again, and read the same forces on the way back"
            plans[text] = self._inserted(back, None)
        if self.recorded.metadata["clock"] == "measured":
            count = round(HOLD_S / LOOK_S)
            held = {rows[-1]: np.full(count, rows[-1]) for rows in peaks.values()}
            text = (
                f"press again, and hold each press at its largest force for {HOLD_S:g} s,"
                f" with a frame every {LOOK_S:g} s"
            )
            plans[text] = self._inserted(held, LOOK_S)
        return plans

    def _peaks(self) -> dict[int, np.ndarray]:
        """Of each press the frames up to its largest force."""
        force = self.recorded.frames["force_N"].to_numpy(float)
        found = {}
        for press in np.unique(self.model.press[self.rows]):
            rows = self.rows[self.model.press[self.rows] == press]
            if press >= 0:
                found[press] = rows[: int(np.argmax(force[rows])) + 1]
        return found

    def _inserted(self, after: dict[int, np.ndarray], wait_s: float | None) -> pd.DataFrame:
        """The frames once more, others after some of them, each `wait_s` later or as usual."""
        rows, waits = [], []
        for row in self.rows:
            more = after.get(row, np.zeros(0, int))
            rows += [row, *more]
            waits += [self.waits_s[row], *np.full(len(more), wait_s or np.median(self.waits_s))]
        return self._timed(np.array(rows), np.array(waits))

    def _elsewhere(self, frames: pd.DataFrame) -> pd.DataFrame:
        """Frames whose touches are turned about the skin's middle, by a quarter of it and half an
        electrode."""
        place = frames["x_mm"].to_numpy() + 1j * frames["y_mm"].to_numpy()
        middle = 0.0
        if self.recorded.metadata["position_frame"] == "robot":
            middle = np.nanmean(place)
        turn = np.exp(1j * (0.5 * np.pi + np.pi / self.recorded.n_electrodes))
        place = middle + turn * (place - middle)
        return frames.assign(x_mm=place.real, y_mm=place.imag)


def _driven(found: Diagnosis, run: _Run) -> Recipe | None:
    """The frames again with every measuring pair in every drive, those on driven electrodes too;
    None where all are read, or where an effect stands at channels of the table as it is.

    The new frames count alone: those recorded, with another table, can only add to the gap. Noise
    and numerical error grow with the reading where it is larger than the median of those recorded.
    """
    recorded, whitening = found.recording, found.search.problem.whitening
    table = recorded.channels
    drives, pairs = np.unique(table[:, :2], axis=0), np.unique(table[:, 2:], axis=0)
    full = np.array([(*drive, *pair) for drive in drives for pair in pairs])
    if len(full) <= len(table) or any(c.kind == "channels" for c in found.after.effects):
        return None
    again = run.again()
    metadata = recorded.metadata | {"channels": full.tolist()}
    query = replace(run.query(again), metadata=metadata)
    simulator = partial(RecordingSimulator, recorded, query)
    model = run.model
    skin = model.skin(found.after.fit.theta[: len(model.calibrations)])
    forward = forward_model(Geometry.from_skin(skin), "diagnose")
    try:
        reading = np.abs(forward.voltages(full))
    except InputError:
        return None
    larger = np.maximum(reading / np.median(np.abs(forward.voltages(table))), 1.0)
    rho = np.full(len(full), np.median(whitening.offset_ratio))
    mask = np.ones((len(again), len(full)), bool)
    covariance = Whitening(mask, np.median(whitening.sd) * larger, rho)
    return Recipe(simulator, covariance, 1.0 + len(again) / len(run.frames))


class _Rolled(RecordingSimulator):
    """The board's electrodes, each on the place of the next."""

    def skin(self, coordinates: np.ndarray) -> Skin:
        """The skin, as the board counts its electrodes."""
        skin = super().skin(coordinates)
        assert skin.electrode_deg is not None
        return replace(skin, electrode_deg=tuple(np.roll(skin.electrode_deg, -1).tolist()))


class _Turned(RecordingSimulator):
    """A recording's frames, and frames after the connector was turned by one electrode: what is on
    the skin has gone to another terminal, what is in the wiring and the instrument stays."""

    def __init__(self, recorded: Recording, run: _Run, again: pd.DataFrame):
        super().__init__(recorded, run.joined(again))
        self._before = RecordingSimulator(
            recorded, run.joined(again[:0]), solved_skins=self.solved_skins
        )
        self._after = _Rolled(recorded, run.query(again), solved_skins=self.solved_skins)

    def voltage(
        self, coordinates: np.ndarray, chosen: list[Setting], accuracy: str | None = None
    ) -> np.ndarray:
        """(N, M) as of `RecordingSimulator`."""
        accuracy = accuracy or self.accuracy(coordinates, chosen)
        assert self.nominal_skin.electrode_deg is not None
        n = len(self.nominal_skin.electrode_deg)
        moved = [
            replace(s, sites=(s.sites - 1) % n)
            if s.effect.stage == "skin" and s.sites is not None
            else s
            for s in chosen
        ]
        before = self._before.voltage(coordinates, chosen, accuracy)
        return np.concatenate([before, self._after.voltage(coordinates, moved, accuracy)])

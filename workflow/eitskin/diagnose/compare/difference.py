"""What changed between two recordings of one skin; but for objects in it, without a model of it.

The control and the later recording share whatever their simulation does not explain. What is left
of their difference beside that which a skin does without a fault (`wander`) is explained by the
fault with the most `evidence`, of those whose change the control's own readings foretell
(`faults`), or by objects that conduct otherwise (`objects`), where the control reads as an even
sheet does. A name is given where the evidence reaches a threshold and no fault at another site has
nearly as much, but for one that can do the same by more freedom. A fault that begins within the
later recording is looked for from each of its quarters on; the frames before that count for the
control.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import f

from eitskin.data.recording import Recording, voltages
from eitskin.diagnose.compare import faults
from eitskin.diagnose.compare.evidence import Evidence, Explained
from eitskin.diagnose.compare.faults import Control, Signature
from eitskin.diagnose.compare.interference import limit, louder, tone_power
from eitskin.diagnose.compare.objects import EXPLAINS, Objects, Sheet, Sought, sought
from eitskin.diagnose.compare.potentials import Potentials
from eitskin.diagnose.compare.wander import Wander, wander
from eitskin.errors import InputError
from eitskin.physics.outline import no_disc

THRESHOLD = 26.0  # nats; set on `python -m concealed.pairs BLOCK OUT`, development and report
MARGIN = 10.0  # nats to the best fault at another site
BEGINS = 6.0  # nats that a beginning within the later recording must bring
NARROWER = 0.8  # of a wider fault's evidence, with which a narrower one is preferred
BESIDE = 0.1  # of the strongest fault's evidence, less than which its own misfit may give
MOST_FOUND = 3
QUARTERS = 4
FEWEST_A_QUARTER = 3  # frames
DEAD = 0.05  # of a reading that a dead channel has at most
CLIPPED, MAINS = "adc-nonlinearity", "mains-interference"
ALIKE = ("voltage", "values", "unit")
UNITS, OF_UNIT = (1e-6, 1e-3, 1e3, 1e6), 0.1  # of each other, as V and mV; to within so much of it


@dataclass(frozen=True)
class Pair:
    """Untouched readings of two recordings of one skin: control (N, M), later (N', M), V, NaN where
    lost; rows (N',): which frames of the later recording these are; moment_s (M,): when each
    channel is read, None where unknown; electrode_deg (n,) and radius_mm of the skin, None where
    unknown."""

    names: tuple[str, str]
    channels: np.ndarray
    n: int
    signed: bool
    moment_s: np.ndarray | None
    control: np.ndarray
    later: np.ndarray
    rows: np.ndarray
    electrode_deg: np.ndarray | None = None
    radius_mm: float | None = None


@dataclass(frozen=True)
class Found:
    """A fault that was found. rival: the best at another site, None without one; named: whether it
    has the evidence and the margin; alternatives: names of others at the same site that have nearly
    as much; since: the row of the later recording where it begins, 0 if it was there from the
    first; change (M,): what it changed, V; ratio: by which share of the same readings; of objects,
    inside: what is known of them."""

    explained: Explained
    rival: Explained | None
    alternatives: tuple[str, ...]
    since: int
    change: np.ndarray
    ratio: float
    inside: "Inside | None" = None

    @property
    def name(self) -> str:
        """As the catalogue has it, where it does."""
        return self.explained.name

    @property
    def margin(self) -> float:
        """Nats to the rival."""
        return np.inf if self.rival is None else self.explained.evidence - self.rival.evidence

    @property
    def named(self) -> bool:
        """Whether it may be given as the answer."""
        enough = self.explained.evidence >= THRESHOLD and self.margin >= MARGIN
        clear = self.inside is None or self.inside.explained >= EXPLAINS
        return enough and clear and not self.explained.spread


@dataclass(frozen=True)
class Inside:
    """Of objects: the share of the difference's square that they explain, standard deviations of
    their coordinates (4 k,), and the misfit on reciprocal pairs held out."""

    explained: float
    spread: np.ndarray
    held_out: dict


@dataclass(frozen=True)
class Difference:
    """found: what was found, strongest first, a last one without a name where something changed
    that has none; lost: channels that the later recording has lost; wander: of the partition that
    was judged; common: by which share all readings moved together, beside what has a name."""

    pair: Pair
    found: list[Found]
    lost: tuple[int, ...]
    wander: Wander
    common: float

    @property
    def moved(self) -> tuple[float, float]:
        """By how many times what readings scatter within the sessions they differ between them
        (rms, less what a skin does by itself), and how often chance gives as much (F test)."""
        if self.wander.count < 1:
            return 0.0, 1.0
        times, known = self.wander.moved, self.wander.prior
        return times, float(f.sf(times**2, self.wander.count, known)) if known else 1.0


def pair(control: Recording, later: Recording, names: tuple[str, str]) -> Pair:
    """Two recordings by their names, to be compared.

    Raises InputError where the recordings have other channels, kinds of values or units, or one has
    no untouched frame with readings.
    """
    if not np.array_equal(control.channels, later.channels):
        mine, its = (f"{len(r.channels)} channels" for r in (later, control))
        if mine == its:
            row = int(np.flatnonzero((control.channels != later.channels).any(axis=1))[0])
            mine = f"{later.channels[row].tolist()} in row {row}"
            its = f"{control.channels[row].tolist()}"
        raise InputError(names[1], "key channels", mine, f"{its}, as in {names[0]}")
    for key in ALIKE:
        if control.metadata[key] != later.metadata[key]:
            expected = f"{control.metadata[key]}, as in {names[0]}"
            raise InputError(names[1], f"key {key}", later.metadata[key], expected)
    still = [_untouched(r, name) for r, name in zip((control, later), names, strict=True)]
    frame_s = later.metadata["frame_s"]
    count = len(control.channels)
    moment_s = None if frame_s is None else frame_s * np.arange(count) / count
    n = max(control.n_electrodes, later.n_electrodes)
    signed = control.metadata["voltage"] == "signed"
    before, after = (r.readings[rows] for r, rows in zip((control, later), still, strict=True))
    _refuse_other_unit(before, after, names)
    skin = control.metadata["skin"]
    angle = skin.get("electrode_deg")
    # Objects are looked for on a disc.
    elsewhere = angle is None or len(angle) != n or no_disc(control.skin) is not None
    angle = None if elsewhere else np.array(angle, float)
    radius = skin.get("radius_mm")
    table = control.channels
    return Pair(names, table, n, signed, moment_s, before, after, still[1], angle, radius)


def _refuse_other_unit(before: np.ndarray, after: np.ndarray, names: tuple[str, str]) -> None:
    """InputError where the later readings are as many times the earlier ones as units are."""
    there = np.isfinite(before).any(axis=0) & np.isfinite(after).any(axis=0)
    sizes = [np.abs(np.nanmean(rows[:, there], axis=0)) for rows in (before, after)]
    known = sizes[0] > 0.0
    times = float(np.median(sizes[1][known] / sizes[0][known])) if known.any() else 1.0
    for unit in UNITS:
        if abs(times / unit - 1.0) < OF_UNIT:
            found = f"readings {times:.4g} times those of {names[0]}"
            raise InputError(names[1], "column voltage_V", found, "both in one unit")


def _untouched(recording: Recording, name: str) -> np.ndarray:
    """Rows of untouched frames with readings."""
    voltage = voltages(recording, name)
    still = ~recording.frames["touch"].to_numpy(bool)
    rows = np.flatnonzero(still & np.isfinite(voltage).any(axis=1))
    if not len(rows):
        raise InputError(name, "column touch", "no untouched frame", "some to compare")
    return rows


def difference(control: Recording, later: Recording, names: tuple[str, str]) -> Difference:
    """Two recordings of one skin compared, as above; InputError as `pair`."""
    both = pair(control, later, names)
    read = np.isfinite(both.control).any(axis=0) & np.isfinite(both.later).any(axis=0)
    potentials = Potentials(both.channels, both.n, read)
    sheet = None
    if both.electrode_deg is not None:
        sheet = Sheet(both.channels, both.electrode_deg, both.signed)
    judged = _begun(both, potentials, sheet).settled()
    found: list[Found] = []
    while judged.ranked and judged.most() >= THRESHOLD:
        one = judged.found()
        if found and one.explained.evidence < BESIDE * found[0].explained.evidence:
            break
        found.append(one)
        if not one.named or len(found) == MOST_FOUND:
            break
        known = [part for each in found for part in each.explained.parts]
        judged = _Begun(both, judged.first, potentials, sheet, known).settled()
    common = _common(judged.wander, found)
    return Difference(both, found, _lost(both), judged.wander, common)


def _begun(both: Pair, potentials: Potentials, sheet: Sheet | None) -> "_Begun":
    """The pair judged from the frame on from which a fault has the most evidence."""
    tried = {}
    for first in _beginnings(len(both.later)):
        tried[first] = _Begun(both, first, potentials, sheet)
    for _ in range(2):
        best = max(tried.values(), key=_Begun.most)
        first = best.beginning() if best.ranked else 0
        if first in tried:
            break
        tried[first] = _Begun(both, first, potentials, sheet)
    best = max(tried.values(), key=_Begun.most)
    return best if best.most() > tried[0].most() + BEGINS else tried[0]


def _beginnings(count: int) -> list[int]:
    """Untouched frames of the later recording from which a fault is looked for."""
    first = [count * quarter // QUARTERS for quarter in range(QUARTERS)]
    return first if count >= QUARTERS * FEWEST_A_QUARTER else first[:1]


def _lost(both: Pair) -> tuple[int, ...]:
    before, after = np.isfinite(both.control).any(axis=0), np.isfinite(both.later)
    ends = ~after[-max(1, len(after) // QUARTERS) :].any(axis=0)
    return tuple(np.flatnonzero(before & ends).tolist())


def _common(wander: Wander, found: Sequence[Found]) -> float:
    """The share by which all readings moved together, beside what has a name."""
    named = sum((one.change for one in found if one.named), start=np.zeros(len(wander.change)))
    mean, change = (v[wander.usable] for v in (wander.mean, wander.change - named))
    ratio = change[mean != 0] / mean[mean != 0]
    return float(np.median(ratio)) if len(ratio) else 0.0


class _Begun:
    """The pair judged as if a fault began with an untouched frame of the later recording; `known`
    are signatures that are found already."""

    def __init__(
        self,
        both: Pair,
        first: int,
        potentials: Potentials,
        sheet: Sheet | None,
        known: Sequence[Signature] = (),
    ):
        self.pair, self.first = both, first
        self.before = np.concatenate([both.control, both.later[:first]])
        self.after = both.later[first:]
        self.wander = wander(self.before, self.after)
        usable = self.wander.usable
        if not np.array_equal(potentials.read, usable):
            potentials = Potentials(both.channels, both.n, usable)
        self.control = Control(potentials, self.wander.mean, both.signed, both.moment_s)
        self.evidence = Evidence(self.wander, known)
        self.families = self._families(known) if self.wander.count > 0 else []
        ranked = [self._best(family) for family in self.families]
        self.sought = self._sought(sheet, known)
        self._rank(ranked, None if self.sought is None else self.sought.first())

    def _rank(self, ranked: list[Explained], objects: Explained | None) -> None:
        """Explanations, and objects with them, in order of their evidence."""
        if objects is not None:
            ranked = [*ranked, objects]
            self.families.append(list(objects.parts))
        self.ranked = sorted(ranked, key=lambda e: -e.evidence)

    def settled(self) -> "_Begun":
        """With as many objects as explain most: dear, so not for every frame to begin with."""
        if self.sought is not None:
            ranked = [e for e in self.ranked if not isinstance(e.parts[0], Objects)]
            self.families = [f for f in self.families if not isinstance(f[0], Objects)]
            self._rank(ranked, self.sought.best())
        return self

    def _sought(self, sheet: Sheet | None, known: Sequence[Signature]) -> Sought | None:
        """Objects, where they can be simulated, none were found before and one explains some."""
        if sheet is None or self.wander.count < 1:
            return None
        if any(isinstance(part, Objects) for part in known):
            return None
        if not sheet.agrees(self.wander.mean, self.wander.usable):
            return None
        return sought(sheet, self.evidence, known)

    def _families(self, known: Sequence[Signature]) -> list[list[Signature]]:
        found = faults.families(self.control)
        found += [[each] for each in faults.everywhere(self.control)]
        found.append(faults.crossed(self.control, self.wander.change, self.wander.scale))
        self.tones = faults.tones(self.control)
        done = {part.name for part in known if part.kind is None}
        found = [[each for each in family if each.name not in done] for family in found]
        self.clip = None if CLIPPED in done else limit(self.before, self.after)
        if self.clip is not None:
            self.clipped = faults.clipped(self.control, self.clip[0])
            found.append([self.clipped])
        if MAINS in done:
            self.tones = []
        return [family for family in [*found, self.tones] if family]

    def _best(self, family: list[Signature]) -> Explained:
        if family is self.tones:
            return self._mains()
        best = self.evidence.best(family)
        if self.clip is not None and family[0] is self.clipped:
            return replace(best, evidence=max(best.evidence, 0.0) + self.clip[1])
        return best

    def _mains(self) -> Explained:
        """The best tone, by what is at rest in the frame and by what turns from frame to frame."""
        assert self.pair.moment_s is not None
        powers = (
            tone_power(frames, self.wander.noise, self.pair.moment_s)
            for frames in (self.before, self.after)
        )
        turning = louder(*powers)
        told = []
        for tone, nats in zip(self.tones, turning, strict=True):
            at_rest = self.evidence.of([tone], self.tones)
            told.append(replace(at_rest, evidence=max(at_rest.evidence, 0.0) + float(nats)))
        return max(told, key=lambda e: e.evidence)

    def most(self) -> float:
        """The evidence for the best fault."""
        return self.ranked[0].evidence if self.ranked else -np.inf

    def found(self) -> Found:
        """The best fault, with its rival."""
        best = self._simplest()
        family = next(f for f in self.families if any(best.parts[0] is p for p in f))
        others = [e for e in self.ranked if e.place != best.place]
        if family is not self.tones and len(family) > 1:
            others.append(self.evidence.elsewhere(best, family))
        sought = self.sought if isinstance(best.parts[0], Objects) else None
        if sought is not None:
            others += filter(None, [sought.other_sign(best), *sought.beside()])
        others.sort(key=lambda e: -e.evidence)
        rival = next((e for e in others if not self.evidence.holds(e, best)), None)
        here = [e for e in self.ranked if e.place == best.place]
        near = [e.name for e in here if e.evidence > best.evidence - MARGIN]
        alternatives = tuple(name for name in dict.fromkeys(near) if name != best.name)
        change = self._change(best)
        mean = np.where(change != 0, self.wander.mean, 0.0)
        ratio = float(change @ mean / (mean @ mean)) if mean.any() else np.inf
        first = self.beginning(change)
        since = int(self.pair.rows[first]) if first else 0
        inside = None
        if sought is not None:
            inside = Inside(sought.explained(best), sought.spread(best), sought.held_out(best))
        return Found(best, rival, alternatives, since, change, ratio, inside)

    def _simplest(self) -> Explained:
        """The best fault, or a narrower one that it holds with nearly as much evidence."""
        best = self.ranked[0]
        for other in self.ranked[1:]:
            enough = max(THRESHOLD, NARROWER * self.ranked[0].evidence)
            if other.evidence < enough or other.spread:
                continue
            if self.evidence.holds(best, other) and not self.evidence.holds(other, best):
                best = other
        return best

    def _change(self, best: Explained) -> np.ndarray:
        """(M,) V: what the fault changed, its free sizes fitted."""
        basis = np.column_stack([part.basis for part in best.parts])
        known = sum(part.shift for part in best.parts if part.shift is not None)
        left = self.evidence.left - self.wander.across(known + np.zeros(len(self.evidence.left)))
        sizes = np.linalg.lstsq(self.wander.across(basis), left, rcond=None)[0]
        return basis @ sizes + known

    def beginning(self, change: np.ndarray | None = None) -> int:
        """The untouched frame of the later recording with which a change (M,), by default the best
        fault's, begins: a step in each frame's share of it (least squares), 0 where no step is much
        better than none."""
        if change is None:
            change = self._change(self.ranked[0])
        direction = self.wander.across(change)
        direction = direction / (direction @ direction or 1.0)
        about = np.nan_to_num(self.pair.later - self.wander.mean)
        share = np.clip(self.wander.across(about.T).T @ direction, -1.0, 2.0)
        count = len(share)
        rest = [((share[k:] - share[k:].mean()) ** 2).sum() for k in range(count)]
        left = np.cumsum(np.append(0.0, share[:-1] ** 2)) + rest + np.finfo(float).tiny
        first = int(np.argmin(left))
        gained = 0.5 * count * np.log(left[0] / left[first])
        return first if gained > BEGINS + np.log(count) else 0

"""What changed between two recordings of one skin; but for objects in it, without a model of it.

The control and the later recording share whatever a simulation would not explain. Their difference
beside what a skin does without a fault (`wander`) is explained by the fault with the most
`evidence`, of those whose change the control's own readings predict (`faults`), or by objects that
conduct otherwise (`objects`), where the control reads as an even sheet does. A fault is named where
its evidence reaches a threshold and no fault at another site has nearly as much, but for one that
can do the same by more freedom. A fault that begins within the later recording is sought from each
of its quarters on; the frames before its onset count for the control. Thresholds were set on the
development and report blocks of docs/concealed/pairs.md.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import f

from eitskin.data.recording import Recording, voltages
from eitskin.diagnose.compare import faults
from eitskin.diagnose.compare.evidence import Evidence, Explanation
from eitskin.diagnose.compare.faults import Control, Signature
from eitskin.diagnose.compare.interference import converter_limit, tone_nats, tone_power
from eitskin.diagnose.compare.objects import (
    LEAST_EXPLAINED,
    Objects,
    ObjectSearch,
    object_search,
)
from eitskin.diagnose.compare.potentials import Potentials
from eitskin.diagnose.compare.sheet import Sheet
from eitskin.diagnose.compare.wander import Wander, wander
from eitskin.errors import InputError
from eitskin.physics.outline import not_simulated
from eitskin.physics.protocol import reciprocal_channels

THRESHOLD_NATS = 26.0  # false names: 2 to 5 % of pairs without a fault
MARGIN_NATS = 10.0  # to the best fault at another site
ONSET_NATS = 6.0  # that an onset within the later recording must bring
NARROW_SHARE = 0.8  # of a wider fault's evidence, with which a narrower one is preferred
LEAST_SECONDARY = 0.1  # of the strongest fault's evidence: less may come from that fault's misfit
MOST_FINDINGS = 3
QUARTERS = 4  # parts of the later recording, with which a fault may begin
FEWEST_A_QUARTER = 3  # frames: fewer have no scatter
CLIPPED, MAINS = "adc-nonlinearity", "mains-interference"
EQUAL_KEYS = ("voltage", "values", "unit")  # of two recordings' metadata
UNIT_RATIOS, UNIT_TOLERANCE = (1e-6, 1e-3, 1e3, 1e6), 0.1  # as of V and mV; relative
FEWEST_PAIRS = 10  # reciprocal, for an odd share
SHARE_RANGE = (-1.0, 2.0)  # of a frame in a change: beyond it lies a loud frame


@dataclass(frozen=True)
class Pair:
    """Untouched readings of two recordings of one skin.

    names: of the recordings; channels (M, 4) of n electrodes; control (N, M), later (N', M), V, NaN
    where lost; later_rows (N',): the frames of the later recording; moment_s (M,): when each
    channel is read within a frame; electrode_deg (n,) and radius_mm: of the skin; None: unknown.
    """

    names: tuple[str, str]
    channels: np.ndarray
    n: int
    signed: bool
    moment_s: np.ndarray | None
    control: np.ndarray
    later: np.ndarray
    later_rows: np.ndarray
    electrode_deg: np.ndarray | None = None
    radius_mm: float | None = None


@dataclass(frozen=True)
class ObjectFit:
    """How well objects explain the difference: the share of its square beyond noise, standard
    deviations (4 k,) of their coordinates, and the misfit of reciprocal pairs held out."""

    explained_share: float
    coordinate_sd: np.ndarray
    held_out: dict


@dataclass(frozen=True)
class Finding:
    """A fault by which the difference is explained.

    rival: the best explanation at another site, None without one; alternatives: names of others at
    the same site with nearly the same evidence; onset_row: of the later recording, 0 where the
    fault was there from its start; change (M,), V, by the fault, and its ratio to the control's
    readings; object_fit: of objects.
    """

    explanation: Explanation
    rival: Explanation | None
    alternatives: tuple[str, ...]
    onset_row: int
    change: np.ndarray
    ratio: float
    object_fit: ObjectFit | None = None

    @property
    def name(self) -> str:
        """As the catalogue of effects has it, where it does."""
        return self.explanation.name

    @property
    def margin(self) -> float:
        """Nats by which the evidence exceeds the rival's."""
        if self.rival is None:
            return np.inf
        return self.explanation.evidence - self.rival.evidence

    @property
    def named(self) -> bool:
        """Whether evidence, margin and explained share allow to name the fault."""
        enough = self.explanation.evidence >= THRESHOLD_NATS and self.margin >= MARGIN_NATS
        clear = self.object_fit is None or self.object_fit.explained_share >= LEAST_EXPLAINED
        return enough and clear and not self.explanation.widespread


@dataclass(frozen=True)
class Difference:
    """The difference of two recordings, explained.

    findings: strongest first; the last has no name where something changed that has none;
    lost_channels: that the later recording has lost; wander: of the split at the onset;
    common_ratio: by which all readings changed together, beside what has a name.
    """

    pair: Pair
    findings: list[Finding]
    lost_channels: tuple[int, ...]
    wander: Wander
    common_ratio: float

    @property
    def change_test(self) -> tuple[float, float]:
        """The rms of the change in units of the scatter within the sessions, across what a skin
        does by itself, and its p-value (F test)."""
        if self.wander.dof < 1:
            return 0.0, 1.0
        rms, prior_dof = self.wander.relative_rms, self.wander.prior_dof
        return rms, float(f.sf(rms**2, self.wander.dof, prior_dof)) if prior_dof else 1.0

    def odd_share(self, change: np.ndarray) -> float | None:
        """The share of the square of a change (M,), V, that reverses when drive and measurement are
        exchanged: 0 of a passive skin's change, a half of what changes each channel by itself.

        None where there are too few reciprocal pairs, or nothing changed in them.
        """
        pairs, signs = reciprocal_channels(self.pair.channels)
        scale = self.wander.scale
        usable = np.isfinite(scale[pairs]).all(axis=1)
        if usable.sum() < FEWEST_PAIRS:
            return None
        a, b = pairs[usable].T
        sign = signs[usable] if self.pair.signed else np.ones(len(a))
        sd = np.hypot(scale[a], scale[b])
        odd = ((change[a] - sign * change[b]) / sd) ** 2
        even = ((change[a] + sign * change[b]) / sd) ** 2
        square = float((odd + even).sum())
        return float(odd.sum() / square) if square > 0 else None


def untouched_pair(control: Recording, later: Recording, names: tuple[str, str]) -> Pair:
    """The untouched readings of two recordings, to be compared.

    Raises InputError where the recordings have other channels, kinds of values or units, or one has
    no untouched frame with readings.
    """
    if not np.array_equal(control.channels, later.channels):
        actual, expected = (f"{len(r.channels)} channels" for r in (later, control))
        if actual == expected:
            row = int(np.flatnonzero((control.channels != later.channels).any(axis=1))[0])
            actual = f"{later.channels[row].tolist()} in row {row}"
            expected = f"{control.channels[row].tolist()}"
        raise InputError(names[1], "key channels", actual, f"{expected}, as in {names[0]}")
    for key in EQUAL_KEYS:
        if control.metadata[key] != later.metadata[key]:
            expected = f"{control.metadata[key]}, as in {names[0]}"
            raise InputError(names[1], f"key {key}", later.metadata[key], expected)
    control_rows = _untouched_rows(control, names[0])
    later_rows = _untouched_rows(later, names[1])
    frame_s = later.metadata["frame_s"]
    count = len(control.channels)
    moment_s = None if frame_s is None else frame_s * np.arange(count) / count
    n = max(control.n_electrodes, later.n_electrodes)
    control_readings, later_readings = control.readings[control_rows], later.readings[later_rows]
    _refuse_other_unit(control_readings, later_readings, names)
    skin = control.metadata["skin"]
    angles = skin.get("electrode_deg")
    # Objects are simulated on a disc.
    if angles is None or len(angles) != n or not_simulated(control.skin) is not None:
        angles = None
    return Pair(
        names,
        control.channels,
        n,
        control.metadata["voltage"] == "signed",
        moment_s,
        control_readings,
        later_readings,
        later_rows,
        None if angles is None else np.array(angles, float),
        skin.get("radius_mm"),
    )


def _refuse_other_unit(control: np.ndarray, later: np.ndarray, names: tuple[str, str]) -> None:
    """Raise InputError where the later readings are the control's times a ratio of units."""
    read = np.isfinite(control).any(axis=0) & np.isfinite(later).any(axis=0)
    levels = [np.abs(np.nanmean(readings[:, read], axis=0)) for readings in (control, later)]
    nonzero = levels[0] > 0.0
    ratio = float(np.median(levels[1][nonzero] / levels[0][nonzero])) if nonzero.any() else 1.0
    for unit_ratio in UNIT_RATIOS:
        if abs(ratio / unit_ratio - 1.0) < UNIT_TOLERANCE:
            actual = f"readings {ratio:.4g} times those of {names[0]}"
            raise InputError(names[1], "column voltage_V", actual, "both in one unit")


def _untouched_rows(recording: Recording, name: str) -> np.ndarray:
    """Rows of untouched frames with readings."""
    voltage = voltages(recording, name)
    untouched = ~recording.frames["touch"].to_numpy(bool)
    rows = np.flatnonzero(untouched & np.isfinite(voltage).any(axis=1))
    if not len(rows):
        raise InputError(name, "column touch", "no untouched frame", "some to compare")
    return rows


def difference(control: Recording, later: Recording, names: tuple[str, str]) -> Difference:
    """The difference of two recordings of one skin, explained; InputError as `untouched_pair`."""
    pair = untouched_pair(control, later, names)
    read = np.isfinite(pair.control).any(axis=0) & np.isfinite(pair.later).any(axis=0)
    potentials = Potentials(pair.channels, pair.n, read)
    sheet = None
    if pair.electrode_deg is not None:
        sheet = Sheet(pair.channels, pair.electrode_deg, pair.signed)
    split = _likeliest_split(pair, potentials, sheet).with_all_objects()
    findings: list[Finding] = []
    while split.ranked and split.evidence_of_best() >= THRESHOLD_NATS:
        finding = split.finding()
        evidence = finding.explanation.evidence
        if findings and evidence < LEAST_SECONDARY * findings[0].explanation.evidence:
            break
        findings.append(finding)
        if not finding.named or len(findings) == MOST_FINDINGS:
            break
        signatures = [s for finding in findings for s in finding.explanation.signatures]
        split = _Split(pair, split.onset, potentials, sheet, signatures).with_all_objects()
    common_ratio = _common_ratio(split.wander, findings)
    return Difference(pair, findings, _lost_channels(pair), split.wander, common_ratio)


def _likeliest_split(pair: Pair, potentials: Potentials, sheet: Sheet | None) -> "_Split":
    """The pair split at the onset from which a fault has the most evidence."""
    splits = {}
    for onset in _quarter_onsets(len(pair.later)):
        splits[onset] = _Split(pair, onset, potentials, sheet)
    for _ in range(2):
        best = max(splits.values(), key=_Split.evidence_of_best)
        onset = best.onset_of(best.change_by(best.ranked[0])) if best.ranked else 0
        if onset in splits:
            break
        splits[onset] = _Split(pair, onset, potentials, sheet)
    best = max(splits.values(), key=_Split.evidence_of_best)
    if best.evidence_of_best() > splits[0].evidence_of_best() + ONSET_NATS:
        return best
    return splits[0]


def _quarter_onsets(count: int) -> list[int]:
    """Untouched frames of the later recording from which a fault is sought."""
    onsets = [count * quarter // QUARTERS for quarter in range(QUARTERS)]
    return onsets if count >= QUARTERS * FEWEST_A_QUARTER else onsets[:1]


def _lost_channels(pair: Pair) -> tuple[int, ...]:
    """Channels that the control has and the last quarter of the later recording has not."""
    control_read, later_read = np.isfinite(pair.control).any(axis=0), np.isfinite(pair.later)
    lost = ~later_read[-max(1, len(later_read) // QUARTERS) :].any(axis=0)
    return tuple(np.flatnonzero(control_read & lost).tolist())


def _common_ratio(wander: Wander, findings: Sequence[Finding]) -> float:
    """The median ratio of the change, beside what has a name, to the control's readings."""
    named = sum((f.change for f in findings if f.named), start=np.zeros(len(wander.change)))
    mean, change = (v[wander.usable] for v in (wander.mean, wander.change - named))
    ratio = change[mean != 0] / mean[mean != 0]
    return float(np.median(ratio)) if len(ratio) else 0.0


class _Split:
    """The pair as if a fault began with an untouched frame of the later recording, its onset.

    named_signatures: of findings that have a name already; ranked: explanations by their evidence.
    """

    def __init__(
        self,
        pair: Pair,
        onset: int,
        potentials: Potentials,
        sheet: Sheet | None,
        named_signatures: Sequence[Signature] = (),
    ):
        self.pair, self.onset = pair, onset
        self.before = np.concatenate([pair.control, pair.later[:onset]])
        self.after = pair.later[onset:]
        self.wander = wander(self.before, self.after)
        usable = self.wander.usable
        if not np.array_equal(potentials.read, usable):
            potentials = Potentials(pair.channels, pair.n, usable)
        self.control = Control(potentials, self.wander.mean, pair.signed, pair.moment_s)
        self.evidence = Evidence(self.wander, named_signatures)
        self.families = self._families(named_signatures) if self.wander.dof > 0 else []
        explanations = [self._best(family) for family in self.families]
        self.search = self._search(sheet, named_signatures)
        self._rank(explanations, None if self.search is None else self.search.single())

    def _rank(self, explanations: list[Explanation], objects: Explanation | None) -> None:
        """Sort explanations, and objects among them, by their evidence."""
        if objects is not None:
            explanations = [*explanations, objects]
            self.families.append(list(objects.signatures))
        self.ranked = sorted(explanations, key=lambda explanation: -explanation.evidence)

    def with_all_objects(self) -> "_Split":
        """The same with as many objects as explain most: too slow for every onset."""
        if self.search is not None:
            faults_alone = [e for e in self.ranked if not isinstance(e.signatures[0], Objects)]
            self.families = [f for f in self.families if not isinstance(f[0], Objects)]
            self._rank(faults_alone, self.search.best())
        return self

    def _search(
        self, sheet: Sheet | None, named_signatures: Sequence[Signature]
    ) -> ObjectSearch | None:
        """The search for objects, where they can be simulated, none is known and one explains
        enough."""
        if sheet is None or self.wander.dof < 1:
            return None
        if any(isinstance(signature, Objects) for signature in named_signatures):
            return None
        if not sheet.resembles(self.wander.mean, self.wander.usable):
            return None
        return object_search(sheet, self.evidence, named_signatures)

    def _families(self, named_signatures: Sequence[Signature]) -> list[list[Signature]]:
        families = faults.families(self.control)
        families += [[signature] for signature in faults.siteless(self.control)]
        families.append(faults.swaps(self.control, self.wander.change, self.wander.scale))
        self.tones = faults.tones(self.control)
        siteless_names = {s.name for s in named_signatures if s.kind is None}
        families = [[s for s in family if s.name not in siteless_names] for family in families]
        self.limit = None if CLIPPED in siteless_names else converter_limit(self.before, self.after)
        if self.limit is not None:
            self.clipping = faults.clipping(self.control, self.limit[0])
            families.append([self.clipping])
        if MAINS in siteless_names:
            self.tones = []
        return [family for family in [*families, self.tones] if family]

    def _best(self, family: list[Signature]) -> Explanation:
        if family is self.tones:
            return self._best_tone()
        best = self.evidence.best(family)
        if self.limit is not None and family[0] is self.clipping:
            return replace(best, evidence=max(best.evidence, 0.0) + self.limit[1])
        return best

    def _best_tone(self) -> Explanation:
        """The best tone, by what is at rest in the frame and by what turns from frame to frame."""
        assert self.pair.moment_s is not None
        powers = (
            tone_power(frames, self.wander.noise, self.pair.moment_s)
            for frames in (self.before, self.after)
        )
        explanations = []
        for tone, nats in zip(self.tones, tone_nats(*powers), strict=True):
            at_rest = self.evidence.explanation([tone], self.tones)
            evidence = max(at_rest.evidence, 0.0) + float(nats)
            explanations.append(replace(at_rest, evidence=evidence))
        return max(explanations, key=lambda explanation: explanation.evidence)

    def evidence_of_best(self) -> float:
        """The evidence of the best explanation."""
        return self.ranked[0].evidence if self.ranked else -np.inf

    def finding(self) -> Finding:
        """The best explanation, with its rival."""
        best = self._narrowest()
        family = next(f for f in self.families if any(best.signatures[0] is s for s in f))
        rivals = [e for e in self.ranked if e.place != best.place]
        if family is not self.tones and len(family) > 1:
            rivals.append(self.evidence.best_elsewhere(best, family))
        search = self.search if isinstance(best.signatures[0], Objects) else None
        if search is not None:
            rivals += filter(None, [search.opposite_sign(best), *search.skin_rivals()])
        rivals.sort(key=lambda rival: -rival.evidence)
        rival = next((r for r in rivals if not self.evidence.contains(r, best)), None)
        same_place = [e for e in self.ranked if e.place == best.place]
        close = [e.name for e in same_place if e.evidence > best.evidence - MARGIN_NATS]
        alternatives = tuple(name for name in dict.fromkeys(close) if name != best.name)
        change = self.change_by(best)
        mean = np.where(change != 0, self.wander.mean, 0.0)
        ratio = float(change @ mean / (mean @ mean)) if mean.any() else np.inf
        onset = self.onset_of(change)
        onset_row = int(self.pair.later_rows[onset]) if onset else 0
        fit = None
        if search is not None:
            fit = ObjectFit(
                search.explained_share(best), search.coordinate_sd(best), search.held_out(best)
            )
        return Finding(best, rival, alternatives, onset_row, change, ratio, fit)

    def _narrowest(self) -> Explanation:
        """The best explanation, or a narrower one that it contains with nearly as much evidence."""
        best = self.ranked[0]
        enough = max(THRESHOLD_NATS, NARROW_SHARE * best.evidence)
        for explanation in self.ranked[1:]:
            if explanation.evidence < enough or explanation.widespread:
                continue
            if self.evidence.contains(best, explanation) and not self.evidence.contains(
                explanation, best
            ):
                best = explanation
        return best

    def change_by(self, explanation: Explanation) -> np.ndarray:
        """The change (M,), V, by a fault, its free sizes fitted."""
        signatures, residual = explanation.signatures, self.evidence.residual
        basis = np.column_stack([signature.basis for signature in signatures])
        shift = sum(s.shift for s in signatures if s.shift is not None)
        residual = residual - self.wander.whitened(shift + np.zeros(len(residual)))
        sizes = np.linalg.lstsq(self.wander.whitened(basis), residual, rcond=None)[0]
        return basis @ sizes + shift

    def onset_of(self, change: np.ndarray) -> int:
        """The untouched frame of the later recording with which a change (M,), V, begins: a step in
        each frame's share of it (least squares), 0 where no step is much better than none."""
        direction = self.wander.whitened(change)
        direction = direction / (direction @ direction or 1.0)
        deviation = np.nan_to_num(self.pair.later - self.wander.mean)
        share = np.clip(self.wander.whitened(deviation.T).T @ direction, *SHARE_RANGE)
        count = len(share)
        square_after = [((share[k:] - share[k:].mean()) ** 2).sum() for k in range(count)]
        square = np.cumsum(np.append(0.0, share[:-1] ** 2)) + square_after + np.finfo(float).tiny
        onset = int(np.argmin(square))
        nats = 0.5 * count * np.log(square[0] / square[onset])
        return onset if nats > ONSET_NATS + np.log(count) else 0

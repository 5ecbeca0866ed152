"""Recordings of any sort, sound or not, and queries of states whose readings they do not hold.

    draw("query:rig", 3), draw("query:belief", 3), draw("query:real", 3)

Equal kinds and seeds give the same recording bit for bit.
"""

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, replace
from zlib import crc32

import numpy as np

from eitskin.data import importers
from eitskin.data.check import WARNING, Check, clipping, measures, steps
from eitskin.data.recording import TOUCH_KEYS, Recording, presses
from eitskin.diagnose.fitting.held_out import error_units, reciprocal_groups, with_frames_before
from eitskin.errors import InputError
from proof.real_sets import listed, renumbered
from witness import cases
from witness.outside import OUTSIDE
from witness.owned import Owned, Truth

WRONG = {  # beliefs, and the largest factor by which they are off, up or down
    "radius_mm": 1.5,
    "thickness_mm": 3.0,
    "conductivity_S_per_m": 10.0,
    "electrode_width_mm": 3.0,
    "contact_impedivity_ohm_m2": 100.0,
    "current_A": 10.0,
    "contrast_per_N": 10.0,
}
HELD_OUT = 5  # one of so many presses, or channels, of a real recording
EXCERPT = (125, 190)  # frames of a real recording, those held out among them: 100 to 150 are left
LEAST_PRESSES = 10  # with fewer, channels are held out
FOREIGN_SEEDS = 1_000_000  # past every seed of `blocks`, which draw of the same laws


@dataclass(frozen=True)
class QueryCase:
    """A recording, a query, and the readings of the query that the recording does not hold.

    description: what was done, in words; readings (Q, M): voltages of a simulation with the white
    noise of its recording, else those measured, NaN where nothing is compared; unit (Q, M): which
    independent unit a reading belongs to, as of `held_out.units`; truth: what an owner's recording
    conceals.
    """

    kind: str
    seed: int
    description: str
    recorded: Recording
    query: Recording
    readings: np.ndarray
    unit: np.ndarray
    truth: Truth | None = None


def draw(kind: str, seed: int) -> QueryCase:
    """One recording and its query. kind: query: and a key of KINDS.

    rig: a sound skin by a rig with one to three errors; belief: one or two beliefs that are wrong;
    foreign: physics outside the catalogue and a rig's errors; shuffled: channels or frames out of
    order; garbage: readings that are none; real: another laboratory's recording, part of it held
    out. Raises InputError for an unknown kind, FileNotFoundError where a real recording is absent.
    """
    word, _, name = kind.partition(":")
    if word != "query" or name not in KINDS:
        expected = f"query: and one of {', '.join(KINDS)}"
        raise InputError("query", "kind", repr(kind), expected)
    return KINDS[name](kind, seed)


def of_owner(owner: Owned) -> QueryCase:
    """An owner's recording and a query of readings that it does not hold: of presses after it, or
    where nobody touches, of channels held out of all its frames."""
    if owner.query is None:
        rng = np.random.default_rng([crc32(f"{owner.kind}, kept out".encode()), owner.seed])
        words, recorded, query, readings = without_channels(owner.recorded, rng)
    else:
        words, recorded, readings = "later presses", owner.recorded, owner.query.readings
        query = Recording(owner.query.frames, None, None, None, owner.query.metadata)
    description = f"{owner.drawn}; {words}"
    return QueryCase(
        owner.kind,
        owner.seed,
        description,
        recorded,
        query,
        readings,
        error_units(query),
        owner.truth,
    )


def check_findings(recorded: Recording, checked: Check) -> dict:
    """The first frames after steps and the ceilings, V, that the check's sentences hold, and its
    warnings, (topic, sentence)."""
    findings = checked.of_severity(WARNING)
    topics = {finding.topic for finding in findings}
    ceilings = []
    if "clipped" in topics:
        stop = measures.clipped_channels(recorded)
        assert stop is not None  # else there is no warning
        ceilings = [clip.ceiling for clip in clipping.ceilings(recorded)]
        ceilings = [stop.ceiling] if len(stop.channels) else ceilings
    return {
        "steps": [step.frame for step in steps.steps(recorded)] if "step" in topics else [],
        "ceilings": ceilings,
        "warnings": [(finding.topic, finding.sentence) for finding in findings],
    }


def _rng(kind: str, seed: int) -> np.random.Generator:
    return np.random.default_rng([crc32(f"{kind}, asked".encode()), seed])


def _sound(kind: str, seed: int) -> cases.Case:
    """A recording that nothing is wrong with, its skin of this kind alone."""
    return cases.draw(kind, seed, names=[])


def _query_case(
    case: cases.Case,
    description: str,
    voltage: np.ndarray | None = None,
    readings: np.ndarray | None = None,
    metadata: dict | None = None,
) -> QueryCase:
    """A case with other voltages, readings of its query or metadata, where these are given."""
    metadata = deepcopy(case.metadata if metadata is None else metadata)
    voltage = case.voltage if voltage is None else voltage
    query = Recording(case.query, None, None, None, metadata)
    return QueryCase(
        case.kind.partition("+")[0],
        case.seed,
        description,
        Recording(case.states, voltage, None, None, metadata),
        query,
        _read(case) if readings is None else readings,
        error_units(query),
    )


def _read(case: cases.Case) -> np.ndarray:
    """(Q, M) V: the readings of a case's query, with white noise."""
    rng = np.random.default_rng([crc32(f"{case.kind}, read".encode()), case.seed])
    return case.query_clean + case.noise_V * rng.standard_normal(case.query_clean.shape)


def _rig(kind: str, seed: int) -> QueryCase:
    case = cases.draw(f"{kind}+rig", seed, names=[])
    return _query_case(case, _rig_words(case))


def _rig_words(case: cases.Case) -> str:
    return ", ".join(f"{error.kind} {error.size:.3g}" for error in case.rig)


def _foreign(kind: str, seed: int) -> QueryCase:
    laws = list(OUTSIDE)
    law = laws[seed % len(laws)]
    case = cases.draw(f"outside:{law}+rig", FOREIGN_SEEDS + seed)
    return replace(_query_case(case, f"{law}, {_rig_words(case)}"), kind=kind, seed=seed)


def _belief(kind: str, seed: int) -> QueryCase:
    case = _sound(kind, seed)
    metadata = deepcopy(case.metadata)
    description = mistake(_rng(kind, seed), metadata)
    return _query_case(case, description, metadata=metadata)


def mistake(rng: np.random.Generator, metadata: dict) -> str:
    """One or two beliefs of an owner, or how the channels are wired, put wrong in the recording's
    metadata; in words."""
    keys = [key for key in WRONG if metadata["skin"][key] is not None] + list(MISTAKES)
    words = []
    for key in rng.choice(keys, int(rng.integers(1, 3)), replace=False).tolist():
        if key in MISTAKES:
            words.append(MISTAKES[key](rng, metadata))
            continue
        factor = float(WRONG[key] ** rng.uniform(0.3, 1.0)) ** float(rng.choice([-1, 1]))
        metadata["skin"][key] *= factor
        words.append(f"{key} x {factor:.3g}")
    return ", ".join(words)


def _turned(rng: np.random.Generator, metadata: dict) -> str:
    turn_deg = float(rng.uniform(5.0, 355.0))
    metadata["skin"]["electrode_deg"] = [a + turn_deg for a in metadata["skin"]["electrode_deg"]]
    return f"electrodes {turn_deg:.3g} deg off"


def _mirrored(rng: np.random.Generator, metadata: dict) -> str:
    metadata["skin"]["electrode_deg"] = [-a % 360.0 for a in metadata["skin"]["electrode_deg"]]
    return "electrodes counted the other way round"


def _exchanged(rng: np.random.Generator, metadata: dict) -> str:
    """Wires in another order than the owner believes: two to all of them."""
    wires = np.arange(cases.N_ELECTRODES)
    exchanged_wires = rng.choice(wires, int(rng.integers(2, len(wires) + 1)), replace=False)
    wires[exchanged_wires] = np.roll(exchanged_wires, 1)
    metadata["channels"] = wires[np.array(metadata["channels"])].tolist()
    return f"{len(exchanged_wires)} electrodes in another order"


def _opposite(rng: np.random.Generator, metadata: dict) -> str:
    metadata["channels"] = [[s, t, minus, plus] for s, t, plus, minus in metadata["channels"]]
    return "plus and minus exchanged"


def _reference(rng: np.random.Generator, metadata: dict) -> str:
    grounded = metadata["source_reference"] == "sink-grounded"
    metadata["source_reference"] = "floating" if grounded else "sink-grounded"
    return f"source believed {metadata['source_reference']}"


MISTAKES: dict[str, Callable[[np.random.Generator, dict], str]] = {
    "turned": _turned,
    "mirrored": _mirrored,
    "exchanged": _exchanged,
    "opposite": _opposite,
    "reference": _reference,
}


def _shuffled(kind: str, seed: int) -> QueryCase:
    """Channels in another order, the query's as well; or frames, against their states."""
    case, rng = _sound(kind, seed), _rng(kind, seed)
    n_frames, n_channels = case.voltage.shape
    description = ("channels", "channels from another on", "frames")[seed % 3]
    if description == "frames":
        return _query_case(case, description, case.voltage[rng.permutation(n_frames)])
    order = rng.permutation(n_channels)
    if description != "channels":
        order = np.roll(np.arange(n_channels), int(rng.integers(1, n_channels)))
    return _query_case(case, description, case.voltage[:, order], _read(case)[:, order])


def _garbage(kind: str, seed: int) -> QueryCase:
    case, rng = _sound(kind, seed), _rng(kind, seed)
    names = list(GARBAGE)
    name = names[seed % len(names)]
    n_frames = len(case.voltage)
    shape = (n_frames + len(case.query), case.voltage.shape[1])
    voltage = float(np.median(np.abs(case.clean[0]))) * GARBAGE[name](rng, shape)
    return _query_case(case, name, voltage[:n_frames], voltage[n_frames:])


GARBAGE: dict[str, Callable[[np.random.Generator, tuple], np.ndarray]] = {  # over the median |v|
    "normal": lambda rng, shape: rng.standard_normal(shape),
    "constant": lambda rng, shape: np.ones(shape),
    "heavy-tailed": lambda rng, shape: rng.standard_t(1.5, shape),
    "a constant a channel": lambda rng, shape: np.tile(
        rng.standard_normal(shape[1]), (shape[0], 1)
    ),
    "walk": lambda rng, shape: 0.1 * np.cumsum(rng.standard_normal(shape), axis=0),
    "few levels": lambda rng, shape: rng.integers(-2, 3, shape).astype(float),
}


def _real(kind: str, seed: int) -> QueryCase:
    paths = listed()
    name = list(paths)[seed % len(paths)]
    if not paths[name].exists():
        message = f"no real recording {name} at {paths[name]}; set EITSKIN_DATA"
        raise FileNotFoundError(message)
    source = importers.load(paths[name])
    split = _without_presses if presses(source).max() + 1 >= LEAST_PRESSES else without_channels
    words, recorded, query, readings = split(source, _rng(kind, seed))
    return QueryCase(kind, seed, f"{name}, {words}", recorded, query, readings, error_units(query))


def _without_presses(
    source: Recording, rng: np.random.Generator
) -> tuple[str, Recording, Recording, np.ndarray]:
    """Presses in a row, each with the untouched frames before it, less some: the last, or any. Of
    those the query has what can be simulated, all where nothing can."""
    frames, group = source.frames, with_frames_before(presses(source))
    count = int(group.max()) + 1
    frame_count = int(rng.integers(EXCERPT[0], EXCERPT[1] + 1))
    number = min(count, round(frame_count * count / len(frames)))
    start, from_end = int(rng.integers(count - number + 1)), rng.uniform() < 0.5
    row = np.arange(start, start + number)
    size = number // HELD_OUT
    press = row[-size:] if from_end else rng.choice(row, size, False)
    held_out = np.isin(group, press)
    given_frames = np.isin(group, row) & ~held_out
    simulable = ~frames["touch"].to_numpy(bool) | frames[list(TOUCH_KEYS)].notna().all(axis=1)
    query_frames = held_out & simulable if (held_out & simulable).any() else held_out
    start_s = float(frames["time_s"][given_frames | query_frames].min())
    recorded = _part(source, given_frames, start_s, source.readings[given_frames])
    words = f"{number} presses from {start}, less {'the last' if from_end else 'any'} {len(press)}"
    return words, recorded, _part(source, query_frames, start_s), source.readings[query_frames]


def without_channels(
    source: Recording, rng: np.random.Generator
) -> tuple[str, Recording, Recording, np.ndarray]:
    """All frames less one in HELD_OUT of the channels, reciprocal ones together: in words; the
    recording; a query of these channels in all the frames, and their readings (N, M), else NaN."""
    group, all_frames = reciprocal_groups(source.channels), np.ones(len(source.frames), bool)
    label = rng.permutation(np.unique(group))
    held_out = np.isin(group, label[: len(label) // HELD_OUT])
    recorded = _part(source, all_frames, 0.0, np.where(held_out, np.nan, source.readings))
    readings = np.where(held_out, source.readings, np.nan)
    return (
        f"less {int(held_out.sum())} channels",
        recorded,
        _part(source, all_frames, 0.0),
        readings,
    )


def _part(
    source: Recording, rows: np.ndarray, start_s: float, voltage: np.ndarray | None = None
) -> Recording:
    frames = renumbered(source.frames[rows], start_s)
    return Recording(frames, voltage, None, None, deepcopy(source.metadata))


KINDS: dict[str, Callable[[str, int], QueryCase]] = {
    "rig": _rig,
    "belief": _belief,
    "foreign": _foreign,
    "shuffled": _shuffled,
    "garbage": _garbage,
    "real": _real,
}

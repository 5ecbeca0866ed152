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
from eitskin.data.recording import TOUCH_KEYS, Recording, presses
from eitskin.diagnose.fitting.held_out import reciprocal_groups, units, with_frames_before
from eitskin.errors import InputError
from proof.real_sets import listed
from witness import cases
from witness.outside import OUTSIDE

WRONG = {  # beliefs, and the largest factor by which they are off, up or down
    "radius_mm": 1.5,
    "thickness_mm": 3.0,
    "conductivity_S_per_m": 10.0,
    "electrode_width_mm": 3.0,
    "contact_impedivity_ohm_m2": 100.0,
    "current_A": 10.0,
    "contrast_per_N": 10.0,
}
KEPT_OUT = 5  # one of so many presses, or channels, of a real recording
FEWEST, MOST = 125, 190  # frames of an excerpt of a real recording, those kept out among them
LEAST_PRESSES = 10  # with fewer, channels are kept out
FOREIGN_SEEDS = 1_000_000  # past every seed of `blocks`, which draw of the same laws


@dataclass(frozen=True)
class Asked:
    """A recording, a query, and what was there.

    drawn: what was done, in words; there (Q, M): voltages of a simulation with the white noise of
    its recording, else those measured, NaN where nothing is compared; unit (Q, M): which
    independent unit a reading belongs to, as of `held_out.units`.
    """

    kind: str
    seed: int
    drawn: str
    recorded: Recording
    query: Recording
    there: np.ndarray
    unit: np.ndarray


def draw(kind: str, seed: int) -> Asked:
    """One recording and its query. kind: query: and a key of KINDS.

    rig: a sound skin by a rig with one to three errors; belief: one or two beliefs that are wrong;
    foreign: physics outside the catalogue and a rig's errors; shuffled: channels or frames out of
    order; garbage: readings that are none; real: another laboratory's recording, part of it kept
    out. Raises InputError for an unknown kind, FileNotFoundError where a real recording is absent.
    """
    word, _, name = kind.partition(":")
    if word != "query" or name not in KINDS:
        expected = f"query: and one of {', '.join(KINDS)}"
        raise InputError("query", "kind", repr(kind), expected)
    return KINDS[name](kind, seed)


def _rng(kind: str, seed: int) -> np.random.Generator:
    return np.random.default_rng([crc32(f"{kind}, asked".encode()), seed])


def _sound(kind: str, seed: int) -> cases.Case:
    """A recording that nothing is wrong with, its skin of this kind alone."""
    return cases.draw(kind, seed, names=[])


def _asked(
    case: cases.Case,
    drawn: str,
    voltage: np.ndarray | None = None,
    there: np.ndarray | None = None,
    metadata: dict | None = None,
) -> Asked:
    """A case, and what is put in the place of its own."""
    metadata = deepcopy(case.metadata if metadata is None else metadata)
    voltage = case.voltage if voltage is None else voltage
    query = Recording(case.query, None, None, None, metadata)
    there = _read(case) if there is None else there
    return Asked(
        case.kind.partition("+")[0],
        case.seed,
        drawn,
        Recording(case.states, voltage, None, None, metadata),
        query,
        there,
        units(query),
    )


def _read(case: cases.Case) -> np.ndarray:
    """(Q, M) V: the readings of a case's query, with white noise."""
    rng = np.random.default_rng([crc32(f"{case.kind}, read".encode()), case.seed])
    return case.query_clean + case.noise_V * rng.standard_normal(case.query_clean.shape)


def _rig(kind: str, seed: int) -> Asked:
    case = cases.draw(f"{kind}+rig", seed, names=[])
    return _asked(case, _told(case))


def _told(case: cases.Case) -> str:
    return ", ".join(f"{error.kind} {error.size:.3g}" for error in case.rig)


def _foreign(kind: str, seed: int) -> Asked:
    laws = list(OUTSIDE)
    law = laws[seed % len(laws)]
    case = cases.draw(f"outside:{law}+rig", FOREIGN_SEEDS + seed)
    return replace(_asked(case, f"{law}, {_told(case)}"), kind=kind, seed=seed)


def _belief(kind: str, seed: int) -> Asked:
    case = _sound(kind, seed)
    metadata = deepcopy(case.metadata)
    said = mistake(_rng(kind, seed), metadata)
    return _asked(case, said, metadata=metadata)


def mistake(rng: np.random.Generator, metadata: dict) -> str:
    """One or two beliefs of an owner, or how the channels are wired, put wrong in the recording's
    metadata; in words."""
    able = [key for key in WRONG if metadata["skin"][key] is not None]
    able += list(MISTAKES)
    said = []
    for key in rng.choice(able, int(rng.integers(1, 3)), replace=False).tolist():
        if key in MISTAKES:
            said.append(MISTAKES[key](rng, metadata))
            continue
        factor = float(WRONG[key] ** rng.uniform(0.3, 1.0)) ** float(rng.choice([-1, 1]))
        metadata["skin"][key] *= factor
        said.append(f"{key} x {factor:.3g}")
    return ", ".join(said)


def _turned(rng: np.random.Generator, metadata: dict) -> str:
    by = float(rng.uniform(5.0, 355.0))
    metadata["skin"]["electrode_deg"] = [a + by for a in metadata["skin"]["electrode_deg"]]
    return f"electrodes {by:.3g} deg off"


def _mirrored(rng: np.random.Generator, metadata: dict) -> str:
    metadata["skin"]["electrode_deg"] = [-a % 360.0 for a in metadata["skin"]["electrode_deg"]]
    return "electrodes counted the other way round"


def _exchanged(rng: np.random.Generator, metadata: dict) -> str:
    """Wires in another order than the owner believes: two to all of them."""
    wires = np.arange(cases.N_ELECTRODES)
    some = rng.choice(wires, int(rng.integers(2, len(wires) + 1)), replace=False)
    wires[some] = np.roll(some, 1)
    metadata["channels"] = wires[np.array(metadata["channels"])].tolist()
    return f"{len(some)} electrodes in another order"


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


def _shuffled(kind: str, seed: int) -> Asked:
    """Channels in another order, the query's as well; or frames, against their states."""
    case, rng = _sound(kind, seed), _rng(kind, seed)
    n_frames, n_channels = case.voltage.shape
    what = ("channels", "channels from another on", "frames")[seed % 3]
    if what == "frames":
        return _asked(case, what, case.voltage[rng.permutation(n_frames)])
    order = rng.permutation(n_channels)
    if what != "channels":
        order = np.roll(np.arange(n_channels), int(rng.integers(1, n_channels)))
    return _asked(case, what, case.voltage[:, order], _read(case)[:, order])


def _garbage(kind: str, seed: int) -> Asked:
    case, rng = _sound(kind, seed), _rng(kind, seed)
    names = list(GARBAGE)
    name = names[seed % len(names)]
    n_frames = len(case.voltage)
    shape = (n_frames + len(case.query), case.voltage.shape[1])
    voltage = float(np.median(np.abs(case.clean[0]))) * GARBAGE[name](rng, shape)
    return _asked(case, name, voltage[:n_frames], voltage[n_frames:])


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


def _real(kind: str, seed: int) -> Asked:
    paths = listed()
    name = list(paths)[seed % len(paths)]
    if not paths[name].exists():
        message = f"no real recording {name} at {paths[name]}; set EITSKIN_DATA"
        raise FileNotFoundError(message)
    whole = importers.load(paths[name])
    parted = _without_presses if presses(whole).max() + 1 >= LEAST_PRESSES else without_channels
    said, recorded, query, there = parted(whole, _rng(kind, seed))
    return Asked(kind, seed, f"{name}, {said}", recorded, query, there, units(query))


def _without_presses(whole: Recording, rng: np.random.Generator) -> tuple:
    """Presses in a row, each with the untouched frames before it, less some: the last, or any. Of
    those the query has what can be simulated, all where nothing can."""
    frames, group = whole.frames, with_frames_before(presses(whole))
    count = int(group.max()) + 1
    number = min(count, round(int(rng.integers(FEWEST, MOST + 1)) * count / len(frames)))
    first, last = int(rng.integers(count - number + 1)), rng.uniform() < 0.5
    row = np.arange(first, first + number)
    out = row[-(number // KEPT_OUT) :] if last else rng.choice(row, number // KEPT_OUT, False)
    kept_out = np.isin(group, out)
    given = np.isin(group, row) & ~kept_out
    known = ~frames["touch"].to_numpy(bool) | frames[list(TOUCH_KEYS)].notna().all(axis=1)
    asked = kept_out & known if (kept_out & known).any() else kept_out
    begin = float(frames["time_s"][given | asked].min())
    recorded = _part(whole, given, begin, whole.readings[given])
    said = f"{number} presses from {first}, less {'the last' if last else 'any'} {len(out)}"
    return said, recorded, _part(whole, asked, begin), whole.readings[asked]


def without_channels(
    whole: Recording, rng: np.random.Generator
) -> tuple[str, Recording, Recording, np.ndarray]:
    """All frames less one in KEPT_OUT of the channels, reciprocal ones together: in words; what is
    left; a query of these channels in all the frames, and what was there (N, M), else NaN."""
    group, every = reciprocal_groups(whole.channels), np.ones(len(whole.frames), bool)
    label = rng.permutation(np.unique(group))
    out = np.isin(group, label[: len(label) // KEPT_OUT])
    recorded = _part(whole, every, 0.0, np.where(out, np.nan, whole.readings))
    there = np.where(out, whole.readings, np.nan)
    return f"less {int(out.sum())} channels", recorded, _part(whole, every, 0.0), there


def _part(
    whole: Recording, rows: np.ndarray, begin: float, voltage: np.ndarray | None = None
) -> Recording:
    frames = whole.frames[rows].reset_index(drop=True)
    numbered = frames.assign(
        frame=np.arange(len(frames), dtype=np.int64), time_s=frames["time_s"] - begin
    )
    return Recording(numbered, voltage, None, None, deepcopy(whole.metadata))


KINDS: dict[str, Callable[[str, int], Asked]] = {
    "rig": _rig,
    "belief": _belief,
    "foreign": _foreign,
    "shuffled": _shuffled,
    "garbage": _garbage,
    "real": _real,
}

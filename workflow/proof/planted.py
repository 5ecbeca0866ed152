"""Real recordings with exactly planted instrument faults.

    draw("real:iirc-tank:offset", 3), draw("real:iirc-tank:none", 3)

The second is the control: the same excerpt unharmed. What the recording's skin and instrument do
besides is unknown, so what a tool says of the control is the reference (`judge.finds_fault`). A
fault is planted in a second instrument behind the real one, on its readings alone, and only where
that is exact: offset, crosstalk, memory and mains need signs, which magnitudes have lost; mains the
moment a channel is read; an exchange of two wires all channels that it makes. Recordings of
differences are left out: they lack the untouched frames, which is all that can be simulated where
nobody measured a force.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from zlib import crc32

import numpy as np
import pandas as pd

from eitskin.data import importers
from eitskin.data.recording import Recording, presses
from eitskin.diagnose.noise.estimate import estimate_noise
from eitskin.errors import InputError
from eitskin.physics.skin import Skin
from proof.judge import site_kind
from proof.real_sets import present, renumbered
from witness import laws, strengths
from witness.cases import scaled, signature

EXCERPT = (100, 150)  # frames: about as many as a simulated recording has
QUERIED = 40  # frames of a query, at most: some more than a simulated query has
SNR = (8.0, 40.0)  # of one frame's share, in the excerpt's noise: as the gaps of simulated cases
LOST = (3, 12)  # channels: a loose wire has as many
FRAME_S = 0.3  # declared where a frame's length is unknown and nothing touches
GAINS = ("drive-gain", "measurement-gain", "channel-gain")
SIGNED = ("offset", "crosstalk", "multiplexer-memory", "mains-interference")
FAULTS = (*GAINS, *SIGNED, "clipping", "electrode-swap", "lost-channels")
NONE = "none"


@dataclass(frozen=True)
class Planted:
    """A case of a real recording, with what a `witness.cases.Case` has; fault: {name, sites,
    parameters} as planted, None in a control.

    effects: the fault where it is one of the catalogue, which lost channels are not. noise_V: what
    `eitskin.diagnose.noise` estimates of the unharmed excerpt, level: its median over the median
    |v|; snr: of the fault in one frame, in that noise, after an overall factor. Nobody knows true,
    clean, query_clean, world and true_states: None. query: the untouched frames that follow, or
    the last one again.
    """

    kind: str
    seed: int
    believed: Skin
    effects: list[dict]
    scopes: list[str]
    snr: list[float]
    snr_given_others: list[float]
    metadata: dict
    states: pd.DataFrame
    voltage: np.ndarray
    noise_V: np.ndarray
    level: float
    query: pd.DataFrame
    fault: dict | None
    true: None = None
    outside: None = None
    clean: None = None
    query_clean: None = None
    world: None = None
    rig: tuple[()] = ()
    true_states: None = None

    @property
    def recorded(self) -> Recording:
        """What its owner has of it."""
        return Recording(self.states, self.voltage, None, None, dict(self.metadata))


def kinds(paths: dict[str, Path] | None = None) -> list[str]:
    """Every kind that can be drawn of the recordings at `paths` (by name; None: of `present`)."""
    names = []
    for name, path in (present() if paths is None else paths).items():
        recorded = _declared(importers.load(path))
        names += [f"real:{name}:{fault}" for fault in (NONE, *FAULTS) if can_plant(recorded, fault)]
    return names


def can_plant(recorded: Recording, fault: str) -> bool:
    """Whether a fault can be planted exactly in a recording. InputError for an unknown one."""
    if fault not in (NONE, *FAULTS):
        raise InputError("case", "fault", repr(fault), f"{NONE} or one of {', '.join(FAULTS)}")
    metadata = recorded.metadata
    signed, is_complete = metadata["voltage"] == "signed", not np.isnan(recorded.readings).any()
    if metadata["values"] != "absolute":
        return False
    if fault == "mains-interference":
        return signed and metadata["clock"] == "measured" and metadata["frame_s"] is not None
    if fault in ("crosstalk", "multiplexer-memory"):
        return signed and is_complete
    if fault == "offset":
        return signed
    if fault == "electrode-swap":
        return bool(swaps(recorded.channels))
    return True


def exchanged(channels: np.ndarray, a: int, b: int) -> tuple[np.ndarray, np.ndarray] | None:
    """Which of the channels (M, 4) each reads once the wires of a and b are exchanged, (M,), and
    with which sign (M,); None where some would be one that was not read."""
    channel_index = {tuple(row): k for k, row in enumerate(channels.tolist())}
    wires = np.arange(channels.max() + 1)
    wires[[a, b]] = b, a
    index, sign = [], []
    for source, sink, plus, minus in wires[channels].tolist():
        orders = (
            ((source, sink, plus, minus), 1.0),
            ((sink, source, minus, plus), 1.0),
            ((sink, source, plus, minus), -1.0),
            ((source, sink, minus, plus), -1.0),
        )
        read = next(
            ((channel_index[row], turned) for row, turned in orders if row in channel_index), None
        )
        if read is None:
            return None
        index.append(read[0])
        sign.append(read[1])
    return np.array(index), np.array(sign)


def swaps(channels: np.ndarray) -> list[tuple[int, int]]:
    """Pairs of electrodes whose exchange turns every one of the channels (M, 4) into one of them.

    Adjacent measurement has none: the pair (a - 1, a) becomes (a - 1, b).
    """
    used = np.unique(channels).tolist()
    pairs = [(a, b) for i, a in enumerate(used) for b in used[i + 1 :]]
    return [pair for pair in pairs if exchanged(channels, *pair) is not None]


def plant(recorded: Recording, faults: list[dict]) -> np.ndarray:
    """(N, M): the recording's readings with faults, in the instrument's order, whatever theirs:
    wires, gains, crosstalk and memory, offset, mains, converter; what is lost is lost last."""
    voltage, channels = recorded.readings.copy(), recorded.channels
    magnitude = recorded.metadata["voltage"] == "magnitude"
    for fault in faults:
        if fault["name"] == "electrode-swap":
            turned = exchanged(channels, *fault["electrodes"])
            assert turned is not None  # they are of `swaps`
            index, sign = turned
            voltage = voltage[:, index] * (1.0 if magnitude else sign)
    no_voltage = np.zeros(voltage.shape)
    time_s = recorded.frames["time_s"].to_numpy(float)
    frame_s = recorded.metadata["frame_s"] or 0.0
    readout = laws.Readout(no_voltage, time_s, channels, frame_s, 0.0)
    voltage = laws.instrument(faults, voltage, no_voltage, readout)
    for fault in faults:
        if fault["name"] == "lost-channels":
            voltage[:, fault["channels"]] = np.nan
    return voltage


def draw(kind: str, seed: int, paths: dict[str, Path] | None = None) -> Planted:
    """One case. kind: real:<set>:<fault>, a set of `paths` (None: those `present`), a fault of
    FAULTS or none.

    The excerpt is 100 to 150 frames in a row, or all there are; the same for all faults of a set
    and seed. Where a measured clock gives no length of a frame and nothing touches, 0.3 s are
    declared, or the least time between two: it changes nothing but the mains. The fault sits at
    definite sites, its SNR in one frame log-uniform in 8 to 40.
    Raises InputError for an unknown kind, an absent set or a fault that cannot be planted.
    """
    word, _, set_and_fault = kind.partition(":")
    name, _, fault = set_and_fault.rpartition(":")
    if word != "real" or not name:
        raise InputError("case", "kind", repr(kind), "real:<set>:<fault>")
    paths = present() if paths is None else paths
    if name not in paths:
        raise InputError(
            "case", "kind", repr(kind), f"one of the sets {', '.join(paths) or 'none'}"
        )
    source = _declared(importers.load(paths[name]))
    if not can_plant(source, fault):
        raise InputError("case", "kind", repr(kind), "a fault that can be planted there exactly")
    excerpt, query = _excerpt(source, np.random.default_rng([crc32(name.encode()), seed]))
    noise = estimate_noise(excerpt).sd
    size = float(np.nanmedian(np.abs(excerpt.readings)))
    rng = np.random.default_rng([crc32(kind.encode()), seed])
    fault_law, snr = draw_fault(rng, fault, excerpt, noise)
    named = [] if fault_law is None or fault == "lost-channels" else [fault_law]
    sited = any(site_kind(item) for item in named)
    return Planted(
        kind=kind,
        seed=seed,
        believed=excerpt.skin,
        effects=named,
        scopes=["sparse" if sited else "common"] * len(named),
        snr=[snr] * len(named),
        snr_given_others=[snr] * len(named),
        metadata=excerpt.metadata,
        states=excerpt.frames,
        voltage=plant(excerpt, [] if fault_law is None else [fault_law]),
        noise_V=noise,
        level=float(np.median(noise)) / size,
        query=query,
        fault=fault_law,
    )


def _declared(recorded: Recording) -> Recording:
    """With a length of frame where that says nothing of the skin: nothing touches it."""
    metadata, time = recorded.metadata, recorded.frames["time_s"].to_numpy(float)
    has_length = metadata["frame_s"] is not None or metadata["clock"] != "measured"
    if has_length or recorded.frames["touch"].any():
        return recorded
    frame_s = float(np.diff(time).min(initial=FRAME_S))
    return replace(recorded, metadata={**metadata, "frame_s": frame_s})


def _excerpt(recorded: Recording, rng: np.random.Generator) -> tuple[Recording, pd.DataFrame]:
    """Frames in a row, presses whole, an untouched one among them; and the states of its query."""
    frames, press = recorded.frames, presses(recorded)
    count, length = len(frames), int(rng.integers(EXCERPT[0], EXCERPT[1] + 1))
    untouched = ~frames["touch"].to_numpy(bool)
    bounds = np.flatnonzero(np.append(True, (press[1:] != press[:-1]) | (press[1:] < 0)))
    bounds = np.append(bounds, count)
    start, end = 0, count
    if count > length:
        stretches = list(_stretches(bounds, length, untouched))
        if not stretches:
            expected = f"an untouched frame among some {length} in a row"
            raise InputError(recorded.metadata["source"], "column touch", "none", expected)
        start, end = stretches[int(rng.integers(len(stretches)))]
    rows = slice(start, end)
    start_s = float(frames["time_s"].iloc[start])
    query = frames[end:][untouched[end:]][:QUERIED]
    if query.empty:
        query = frames[untouched][-1:]
    return (
        Recording(
            renumbered(frames[rows], start_s),
            recorded.readings[rows],
            None,
            None,
            recorded.metadata,
        ),
        renumbered(query, start_s),
    )


def _stretches(bounds: np.ndarray, length: int, untouched: np.ndarray) -> Iterator[tuple[int, int]]:
    """Start and end of stretches of at most `length` frames between rows
    at which a recording may be cut, with an untouched one; longer only where one press is."""
    for i, start in enumerate(bounds[:-1].tolist()):
        if start + length > bounds[-1]:
            return
        index = int(np.searchsorted(bounds, start + length, side="right")) - 1
        end = int(bounds[max(index, i + 1)])
        if untouched[start:end].any():
            yield start, end


def draw_fault(
    rng: np.random.Generator, name: str, recorded: Recording, noise: np.ndarray
) -> tuple[dict | None, float]:
    """A fault of FAULTS or none, and what it shows in one frame of a recording, in noise (M,) V; of
    lost channels and a control 0."""
    channels = recorded.channels
    if name == NONE:
        return None, 0.0
    if name == "lost-channels":
        number = min(int(rng.integers(LOST[0], LOST[1] + 1)), len(channels) // 4)
        lost = sorted(rng.choice(len(channels), number, replace=False).tolist())
        return {"name": name, "channels": lost}, 0.0
    plain = recorded.readings

    def visible_snr(law: dict) -> float:
        changed = plant(recorded, [law])
        finite = np.isfinite(changed) & np.isfinite(plain)
        harmed, sound = (np.where(finite, voltage, 0.0) for voltage in (changed, plain))
        return signature(harmed, sound, noise) / float(np.sqrt(len(plain)))

    if name == "electrode-swap":
        possible = swaps(channels)
        pair = possible[int(rng.integers(len(possible)))]
        law = {"name": name, "electrodes": list(pair), "parameters": {}}
        return law, visible_snr(law)
    snr_wanted = float(np.exp(rng.uniform(*np.log(SNR))))
    while True:
        strength = _strength(rng, name, recorded)
        # As of all faults but those above.
        assert strength.unit is not None and strength.max_strength is not None
        if strength.scope != "dense" and visible_snr(strength.law_at(strength.max_strength)) > 0.0:

            def at(a: float, law: Callable[[float], dict] = strength.law_at) -> float:
                return visible_snr(law(a))

            a, snr = scaled(at, strength.unit, strength.max_strength, snr_wanted)
            return strength.law_at(a), snr


def _strength(rng: np.random.Generator, name: str, recorded: Recording) -> strengths.Strength:
    """A fault at random sites, as the witness draws it."""
    voltage, angles = recorded.readings, tuple(range(recorded.n_electrodes))
    if name == "clipping":
        largest = float(np.nanmax(np.abs(voltage)))

        def at(a: float) -> dict:
            return {"name": "adc-nonlinearity", "parameters": {"limit_V": largest * (1.0 - a)}}

        return strengths.Strength(at, 0.02, 0.5, "common")
    untouched_frames = voltage[~recorded.frames["touch"].to_numpy(bool)]
    untouched = np.nan_to_num(untouched_frames).mean(axis=0)
    skin = replace(recorded.skin, electrode_deg=angles)
    scene = strengths.Scene(skin, recorded.channels, untouched, None, False, 0.0)
    return strengths.DRAWN[name](rng, scene)

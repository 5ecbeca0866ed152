"""Recordings in which one knows what is concealed.

    draw("single:contact-impedance", 7), draw("null", 1), draw("pair", 3), draw("outside:palm", 2),
    draw("null", 1, generator="elements"), draw("pair+rig", 3), draw("null+rig:spikes", 1)

Sixteen electrodes, adjacent drives and pairs; what is drawn is in `draw`. Equal kinds and seeds
give the same case bit for bit.
"""

import json
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from eitskin.atomic import atomic_path
from eitskin.data import recording
from eitskin.errors import InputError
from eitskin.physics.protocol import channel_table
from eitskin.physics.skin import Skin
from witness import outside, rig_errors, strengths
from witness.generators import GENERATORS, LAWS, Generator
from witness.rig_errors import USUAL, RigError
from witness.schedule import Keep, query_frames, recording_frames
from witness.world import World

N_ELECTRODES = 16
LEAST_LEVEL, MOST_LEVEL = 3e-4, 2e-2  # noise over the median |v|
SINGLE_SNR, SET_SNR, OUTSIDE_SNR = (10.0, 60.0), (15.0, 80.0), (20.0, 100.0)
CLEAR_MM = 8.0  # radius of a disc that nobody touches, for laws that sit in one
BEYOND = 1e12  # an SNR that no strength shows
APART_MM, NO_TANGENT_MM = 1.5, 0.5  # from an edge to that of any touch; where they may cross
# Two of a group would need what the witness does not solve, or not soon, or be one effect.
APART_NAMES = (
    *(
        ("third-dimension", name)
        for name in (
            "domain-shape",
            "anisotropy",
            "conductivity-gradient",
            "conductivity-patch",
            "indenter-grounding",
            "conductivity-drift",
            "contact-drift",
            "force-dependent-impedance",
        )
    ),
    ("anisotropy", "conductivity-gradient", "indenter-grounding"),
    ("electrode-open", "electrode-swap"),
)
# An effect at a strength, its unit, the largest strength; unit None: at the largest alone.
Maker = tuple[Callable[[float], dict | outside.Outside], float | None, float]
NEEDS = {"contact-impedance": "contact_impedivity_ohm_m2", "touch-contrast": "contrast_per_N"}


@dataclass(frozen=True)
class Alike:
    """A drawing in which frames and metadata tell nothing of the kind, but for what is `deep`.

    Every source is sink-grounded and every owner knows the contrast, for else there are names that
    nothing could show; a third do not know the contacts, whatever the kind; all touches keep clear
    of a disc in which a law may sit. query_frames: of every query; deep: the owner tells of a body
    with low electrodes, without which there is no third dimension to be seen; levels: the noise
    over the median |v|, from and to.
    """

    query_frames: int
    deep: bool = False
    levels: tuple[float, float] = (LEAST_LEVEL, MOST_LEVEL)


@dataclass(frozen=True)
class Case:
    """One recording with its truth.

    believed, true: the skin; effects: in the configuration's form, with their scopes and snr (of
    the signature that is left after an overall factor; `snr`: alone, `snr_given_others`: in its
    set); outside: {law, parameters, snr} or None; states, query: frames as the recording format has
    them; clean, voltage (N, M), query_clean (Q, M) V; noise_V (M,): sd; level: of the median |v|;
    world: that made clean, with the bodies it solved; rig: errors of the rig, by which `states` are
    off the true_states, at which `clean` was made, and `voltage` off `clean`.
    """

    kind: str
    seed: int
    believed: Skin
    true: Skin
    effects: list[dict]
    scopes: list[str]
    snr: list[float]
    snr_given_others: list[float]
    outside: dict | None
    metadata: dict
    states: pd.DataFrame
    clean: np.ndarray
    voltage: np.ndarray
    noise_V: np.ndarray
    level: float
    query: pd.DataFrame
    query_clean: np.ndarray
    world: World
    rig: tuple[RigError, ...]
    true_states: pd.DataFrame

    @property
    def recorded(self) -> recording.Recording:
        """What its owner has of it."""
        return recording.Recording(self.states, self.voltage, None, None, dict(self.metadata))


def owners_metadata(channels: np.ndarray, frame_s: float, believed: Skin) -> dict:
    """Metadata of a simulated recording as its owner writes them; channels (M, 4); frame_s: s."""
    return recording.metadata_of(channels, believed.metadata(), "simulation", frame_s=frame_s)


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """A number between two, evenly in its logarithm, of three significant digits."""
    return float(f"{np.exp(rng.uniform(np.log(low), np.log(high))):.3g}")


class _Shown:
    """What a world makes of some states; of laws asked for before, the same again."""

    def __init__(self, world: World, states: pd.DataFrame):
        self.world, self.states = world, states
        self._known: dict = {}

    def readings(self, laws: list[dict], hidden: outside.Outside | None = None) -> np.ndarray:
        """(N, M) V, noise-free."""
        key = repr((laws, hidden))
        if key not in self._known:
            self._known[key] = self.world.readings(self.states, laws, hidden)
        return self._known[key]

    def snr(self, made: dict | outside.Outside, noise_V: np.ndarray) -> float:
        """SNR of one law, of the catalogue or outside it, in noise (M,) V."""
        laws, hidden = ([made], None) if isinstance(made, dict) else ([], made)
        return signature(self.readings(laws, hidden), self.readings([]), noise_V)


@dataclass(frozen=True)
class _Bench:
    """What there is before anything is concealed: skin: as drawn; free: a disc (x, y, radius), mm,
    in which a law may sit; grounded: the source's sink; the others as of `Case`."""

    skin: Skin
    true: Skin
    believed: Skin
    frame_s: float
    grounded: bool
    free: tuple[float, float, float]
    channels: np.ndarray
    states: pd.DataFrame
    query: pd.DataFrame

    def world(self, generator: str) -> World:
        """What answers the frames."""
        return World(self.true, self.channels, self.frame_s, self.grounded, generator=generator)

    def scene(self, untouched_V: np.ndarray) -> strengths.Scene:
        """What effects are drawn for, with readings (M,) V of the untouched skin."""
        thickness = self.skin.thickness_mm
        assert thickness is not None
        return strengths.Scene(
            self.believed, self.channels, untouched_V, self.free, self.grounded, thickness
        )


def together(names: Sequence[str]) -> bool:
    """Whether the witness can put effects into one recording."""
    return all(len(set(group) & set(names)) < 2 for group in APART_NAMES)


def names_of(
    kind: str, rng: np.random.Generator, generator: str = "boundary"
) -> tuple[list[str], str | None]:
    """The effects of a kind, drawn where it leaves them open among those that the generator does,
    and the law outside the catalogue.

    Raises InputError for an unknown kind, or one that the generator cannot do.
    """
    word, _, name = kind.partition(":")
    solver = _generator(generator)
    if word in ("single", "outside") and name in solver.unable:
        others = ", ".join(g for g, one in GENERATORS.items() if one.does(name))
        raise InputError("case", f"generator of {kind}", repr(generator), others)
    if kind == "null":
        return [], None
    if word == "single" and name in strengths.DRAWN:
        return [name], None
    if word == "outside" and name in LAWS:
        return [], name
    if kind in ("pair", "triple"):
        while True:
            size = 2 if kind == "pair" else 3
            able = [drawn for drawn in sorted(strengths.DRAWN) if solver.does(drawn)]
            chosen = rng.choice(able, size, replace=False).tolist()
            if together(chosen):
                return chosen, None
    expected = "null, single:<name>, pair, triple or outside:<law>"
    raise InputError("case", "kind", repr(kind), expected)


def _generator(name: str) -> Generator:
    if name not in GENERATORS:
        raise InputError("case", "generator", repr(name), ", ".join(sorted(GENERATORS)))
    return GENERATORS[name]


def _draw_skin(rng: np.random.Generator) -> Skin:
    def between(low: float, high: float, digits: int) -> float:
        return round(float(rng.uniform(low, high)), digits)

    return Skin(
        radius_mm=between(50.0, 90.0, 1),
        thickness_mm=between(2.0, 4.0, 2),
        conductivity_S_per_m=between(0.2, 1.0, 3),
        electrode_deg=tuple((360.0 / N_ELECTRODES * np.arange(N_ELECTRODES)).tolist()),
        electrode_width_mm=between(4.0, 9.0, 1),
        contact_impedivity_ohm_m2=log_uniform(rng, 5e-4, 1e-2),
        current_A=log_uniform(rng, 1e-4, 5e-3),
        contrast_per_N=between(0.2, 1.0, 3),
    )


def _deepened(rng: np.random.Generator, skin: Skin) -> Skin:
    """A skin 10 to 25 mm thick, its electrodes 3 to 8 mm high."""
    depth = round(float(rng.uniform(10.0, 25.0)), 1)
    height = round(float(rng.uniform(3.0, 8.0)), 1)
    z = round(float(rng.uniform(0.5 * height, depth - 0.5 * height)), 2)
    return replace(
        skin, thickness_mm=depth, electrode_height_mm=height, electrode_z_mm=max(z, 0.5 * height)
    )


def _forgotten(rng: np.random.Generator, skin: Skin, names: list[str], alike: bool) -> Skin:
    """In a third of the cases the owner does not know the contacts, or the contrast, or both;
    alike: the contacts, whatever the names."""
    unknown = rng.uniform() < 1 / 3
    which = int(rng.integers(3))
    if not unknown:
        return skin
    if alike:
        return replace(skin, contact_impedivity_ohm_m2=None)
    keys: tuple[str, ...] = ("contact_impedivity_ohm_m2", "contrast_per_N")
    keys = keys if which == 2 else keys[which : which + 1]
    kept = {NEEDS[name] for name in names if name in NEEDS}
    return replace(skin, **{key: None for key in keys if key not in kept})


def _drawn(name: str, rng: np.random.Generator, scene: strengths.Scene) -> strengths.Strength:
    """An effect as it is drawn; not all contacts alike where nobody knows their impedance."""
    while True:
        drawn = strengths.DRAWN[name](rng, scene)
        known = scene.skin.contact_impedivity_ohm_m2 is not None
        if known or name != "contact-impedance" or drawn.scope != "common":
            return drawn


def _free_disc(rng: np.random.Generator, radius_mm: float, low: float, high: float) -> tuple:
    r = radius_mm * np.sqrt(rng.uniform(0.0, 0.5))
    phi = rng.uniform(0.0, 2.0 * np.pi)
    place = r * np.exp(1j * phi)
    values = (place.real, place.imag, rng.uniform(low, high))
    return tuple(round(float(value), 2) for value in values)


def signature(changed: np.ndarray, plain: np.ndarray, noise_V: np.ndarray) -> float:
    """SNR of changed - plain (N, M) V in noise (M,) V, without what an overall factor explains."""
    white = ((changed - plain) / noise_V).ravel()
    factor = (plain / noise_V).ravel()
    left = white - factor * (factor @ white) / (factor @ factor)
    return float(np.linalg.norm(left))


def scaled(
    shown: Callable[[float], float], unit: float, most: float, wanted: float
) -> tuple[float, float]:
    """The strength at which shown(strength), an SNR, is the wanted one to 5 %, or the largest
    that is possible; and what it shows. shown raises ValueError where the world has no such state.
    """
    strength, best = min(unit, most), (0.0, 0.0)
    for _ in range(12):
        strength = float(f"{strength:.4g}")
        try:
            snr = shown(strength)
        except ValueError:
            most = 0.9 * strength
            strength = 0.5 * (best[0] + most) if best[0] < most else 0.5 * most
            continue
        if abs(np.log(max(snr, 1e-9) / wanted)) < abs(np.log(max(best[1], 1e-9) / wanted)):
            best = strength, snr
        if abs(snr / wanted - 1.0) < 0.05:
            break
        step = float(np.clip(wanted / max(snr, 1e-9), 0.1, 10.0))
        if step > 1.0 and strength >= 0.999 * most:
            break
        strength = min(strength * step, most)
    return best


def draw(
    kind: str,
    seed: int,
    frames: int | None = None,
    generator: str = "boundary",
    names: list[str] | None = None,
    alike: Alike | None = None,
    share: float | None = None,
) -> Case:
    """One case. kind: null, single:<name>, pair, triple or outside:<law>; or any word, where the
    `names` of its effects are given; with +rig, the same case recorded by a rig with errors, or
    with +rig:<kind>,<kind> with these. generator: who solves what is stored, of
    `generators.GENERATORS`; strengths, and their SNR, are found by the boundary where it does the
    law. alike: as of `Alike`.

    Skin: radius 50 to 90 mm, thickness 2 to 4 mm (10 to 25 as a body), contacts 4 to 9 mm wide
    of 5e-4 to 1e-2 ohm m2, conductivity up to 15 % off; 100 to 150 frames, or as many as `frames`
    says; noise 0.03 % to 2 % of the median |v|. SNR 10 to 60 for single effects, 15 to 80 in sets,
    20 to 100 outside the catalogue; where no physical strength shows that much, the noise falls to
    0.03 % at the least, or to the generator's least. With `share`, strengths are that of the
    largest physical ones instead.
    Raises InputError for an unknown kind, one that the generator cannot do, or a `share` of a
    strength that is drawn.
    """
    whole, (kind, _, rig) = kind, kind.partition("+")
    rng = np.random.default_rng([zlib.crc32(kind.encode()), seed])
    names, law = names_of(kind, rng, generator) if names is None else (names, None)
    levels = (LEAST_LEVEL, MOST_LEVEL) if alike is None else alike.levels
    bench = _bench(rng, names, law, frames, alike)
    searched = generator if law in outside.OUTSIDE_SOLID else "boundary"
    shown = _Shown(bench.world(searched), bench.states)
    floor = max(levels[0], GENERATORS[generator].least_level)
    concealed = _concealed(rng, bench, shown, names, law, levels, floor, share)
    clean = _noiseless(bench, shown, concealed, generator)
    errors = _rig_errors(rig, np.random.default_rng([zlib.crc32(f"{kind}+rig".encode()), seed]))
    return _recorded(replace(clean, kind=whole, seed=seed), errors, rng)


def _bench(
    rng: np.random.Generator,
    names: list[str],
    law: str | None,
    frames: int | None,
    alike: Alike | None,
) -> _Bench:
    """A skin and its frames that suit the names of effects and a law outside the catalogue."""
    skin = _draw_skin(rng)
    deep = "third-dimension" in names or (alike is not None and alike.deep)
    if deep:
        skin = _deepened(rng, skin)
    believed = _forgotten(rng, skin, names, alike is not None)
    if deep and rng.uniform() < 0.5:
        believed = replace(believed, thickness_mm=None)
    assert skin.radius_mm is not None and skin.conductivity_S_per_m is not None
    off = 1.0 + rng.uniform(-0.15, 0.15)
    true = replace(skin, conductivity_S_per_m=float(skin.conductivity_S_per_m * off))
    frame_s = round(float(rng.uniform(0.2, 0.4)), 3)
    grounded = "indenter-grounding" in names or ("ground-leak" in names and rng.uniform() < 0.5)
    free, keep = _kept_clear(rng, skin.radius_mm, names, law, alike)
    states = recording_frames(rng, skin.radius_mm, frame_s, keep, frames)
    number = None if alike is None else alike.query_frames
    query = query_frames(rng, states, skin.radius_mm, frame_s, keep, number)
    channels = channel_table(N_ELECTRODES)
    grounded = grounded or alike is not None
    return _Bench(skin, true, believed, frame_s, grounded, free, channels, states, query)


def _kept_clear(
    rng: np.random.Generator,
    radius_mm: float,
    names: list[str],
    law: str | None,
    alike: Alike | None,
) -> tuple[tuple[float, float, float], Keep]:
    """A disc (x, y, radius), mm, in which a law may sit, and what touches keep clear of."""
    x, y, reach = _free_disc(rng, radius_mm, 6.0, 13.0)
    clear = law is not None and LAWS[law].keeps_clear
    free = (x, y, CLEAR_MM if clear else reach)
    if alike is not None:
        return free, Keep(((x, y, max(reach, CLEAR_MM)),), APART_MM, clear=True)
    if clear:
        return free, Keep((free,), APART_MM)
    if "conductivity-patch" in names:
        crossed = "indenter-grounding" not in names
        return free, Keep((free,), NO_TANGENT_MM if crossed else APART_MM, crossed)
    return free, Keep()


@dataclass(frozen=True)
class _Concealed:
    """What a case conceals, and its noise; hidden: a law outside the catalogue, `outside` its entry
    in the truth; noise_V (M,): sd; the others as of `Case`."""

    effects: list[dict]
    scopes: list[str]
    snr: list[float]
    hidden: outside.Outside | None
    outside: dict | None
    level: float
    noise_V: np.ndarray


def _concealed(
    rng: np.random.Generator,
    bench: _Bench,
    shown: _Shown,
    names: list[str],
    law: str | None,
    levels: tuple[float, float],
    floor: float,
    share: float | None,
) -> _Concealed:
    """Named effects, or a law outside the catalogue, with strengths that show; levels: of the
    noise, from and to, `floor` the least after all; share: as of `draw`."""
    plain = shown.readings([])
    level = max(log_uniform(rng, *levels), floor)
    mixed = rng.uniform(0.2, 0.8) if rng.uniform() < 0.3 else 0.0
    scene = bench.scene(plain[0])
    drawn = [_drawn(name, rng, scene) for name in names]
    # Where a wire is off or on another electrode, the noise is that of what the board then reads.
    read = shown.readings([one.at(0.0) for one in drawn if one.unit is None])
    median = float(np.median(np.abs(plain[0])))
    noise = level * ((1.0 - mixed) * median + mixed * np.abs(read[0]))
    hidden = None if law is None else _outside(rng, law, bench, plain[0])
    makers = _makers(drawn, law, hidden, share)
    band = OUTSIDE_SNR if law else SINGLE_SNR if len(names) < 2 else SET_SNR
    low, high = np.log(band)
    wanted = np.exp(rng.uniform(low, high, len(makers)))
    if share is not None:
        wanted[:] = BEYOND
    found = _strengths(shown, makers, wanted, noise)
    shares = (snr / want for (_, snr), want in zip(found, wanted, strict=True))
    lack = min(shares, default=1)
    if lack < 0.9 and share is None:
        # What is physical is too weak in this noise: there is less of it then.
        quieter = max(lack, floor / level)
        level, noise = level * quieter, noise * quieter
        found = _strengths(shown, makers, wanted, noise)
    amounts = iter(found)
    effects, snr, other = [], [], None
    for one in drawn:
        fixed = one.unit is None
        a, reached = (0.0, shown.snr(one.at(0.0), noise)) if fixed else next(amounts)
        effects.append(one.at(a))
        snr.append(reached)
    if hidden is not None:
        a, reached = next(amounts)
        hidden = replace(hidden, amount=a)
        other = {"law": law, "parameters": hidden.parameters(), "snr": reached}
    return _Concealed(effects, [one.scope for one in drawn], snr, hidden, other, level, noise)


def _makers(
    drawn: list[strengths.Strength],
    law: str | None,
    hidden: outside.Outside | None,
    share: float | None,
) -> list[Maker]:
    """(at, unit, most) of each effect that has a strength, or of the law outside the catalogue."""
    makers: list[Maker] = [
        (one.at, one.unit, one.most)
        for one in drawn
        if one.unit is not None and one.most is not None
    ]
    if hidden is not None:
        unit = None if law in outside.OUTSIDE_SOLID else 0.1 * hidden.most
        makers = [(lambda a: replace(hidden, amount=a), unit, hidden.amount)]
    if share is None:
        return makers
    if law in outside.OUTSIDE_SOLID:
        raise InputError("case", "share", f"{share:g}", f"none with {law}: its strength is drawn")
    return [
        (at, min(unit, share * most), share * most) for at, unit, most in makers if unit is not None
    ]


def _noiseless(bench: _Bench, shown: _Shown, made: _Concealed, generator: str) -> Case:
    """The case before a rig records it, noise-free, its kind and seed not told yet."""
    effects, world, states = made.effects, shown.world, bench.states
    clean = shown.readings(effects, made.hidden)
    given = list(made.snr)
    if len(effects) > 1:
        rest = [[e for e in effects if e is not one] for one in effects]
        given = [signature(clean, shown.readings(r), made.noise_V) for r in rest]
    if generator != world.generator.name:
        world = bench.world(generator)
        clean = world.readings(states, effects, made.hidden)
    largest = float(states["force_N"].max())
    metadata = owners_metadata(bench.channels, bench.frame_s, bench.believed)
    metadata["source_reference"] = "sink-grounded" if bench.grounded else "floating"
    return Case(
        kind="",
        seed=0,
        believed=bench.believed,
        true=bench.true,
        effects=effects,
        scopes=made.scopes,
        snr=made.snr,
        snr_given_others=given,
        outside=made.outside,
        metadata=metadata,
        states=states,
        clean=clean,
        voltage=clean,
        noise_V=made.noise_V,
        level=made.level,
        query=bench.query,
        query_clean=world.readings(bench.query, effects, made.hidden, largest),
        world=world,
        rig=(),
        true_states=states,
    )


def again(case: Case, rig: str, number: int) -> Case:
    """The same skin and frames, recorded once more at the same level of noise.

    rig: what follows + in a kind, or nothing; its sizes, and the noise, are drawn anew for every
    `number`. Raises InputError for a case that a rig with errors recorded, or an unknown rig.
    """
    if case.rig:
        raise InputError("case", "kind", repr(case.kind), "one without +rig")
    kind = f"{case.kind}+{rig}" if rig else case.kind
    rng = np.random.default_rng([zlib.crc32(kind.encode()), case.seed, number])
    return _recorded(replace(case, kind=kind), _rig_errors(rig, rng), rng)


def _recorded(case: Case, errors: tuple[RigError, ...], rng: np.random.Generator) -> Case:
    """A case as a rig with errors records its noise-free readings, the noise drawn."""
    metadata, clean, query_clean = case.metadata, case.clean, case.query_clean
    if rig_errors.magnitudes(errors):
        metadata = {**metadata, "voltage": "magnitude"}
        clean, query_clean = np.abs(clean), np.abs(query_clean)
    return replace(
        case,
        metadata=metadata,
        states=rig_errors.reported(case.true_states, errors),
        clean=clean,
        voltage=rig_errors.read(clean, errors, case.true_states, case.noise_V, rng),
        query_clean=query_clean,
        rig=errors,
    )


def _rig_errors(rig: str, rng: np.random.Generator) -> tuple[RigError, ...]:
    """What follows + in a kind: none, errors drawn, or those named; raises InputError."""
    if not rig:
        return ()
    word, _, named = rig.partition(":")
    kinds = named.split(",") if named else None
    if word != "rig" or (kinds and not set(kinds) <= set(USUAL)):
        expected = f"rig, or rig: and some of {', '.join(USUAL)}"
        raise InputError("case", "kind", repr(f"+{rig}"), expected)
    return tuple(rig_errors.draw(rng, kinds))


def _strengths(
    shown: _Shown, makers: list[Maker], wanted: np.ndarray, noise_V: np.ndarray
) -> list[tuple[float, float]]:
    """Strength and SNR of each maker (at, unit, most), as `scaled`; without a unit, of `most`."""

    def show(at: Callable[[float], dict | outside.Outside], a: float) -> float:
        return shown.snr(at(a), noise_V)

    return [
        (most, show(at, most)) if unit is None else scaled(partial(show, at), unit, most, want)
        for (at, unit, most), want in zip(makers, wanted, strict=True)
    ]


def _outside(
    rng: np.random.Generator, law: str, bench: _Bench, untouched_V: np.ndarray
) -> outside.Outside:
    states = bench.states
    presses = states["contact"].dropna().unique().astype(int)
    end, radius = float(states["time_s"].iloc[-1]), bench.skin.radius_mm
    assert radius is not None
    scene = outside.Scene(N_ELECTRODES, presses, end, radius, bench.free, untouched_V)
    drawn = LAWS[law].draw(rng, scene)
    if isinstance(drawn, outside.Palm):
        drawn = replace(drawn, radius_mm=round(float(rng.uniform(4.0, 8.0)), 2))
    return drawn


def write(case: Case, folder: str | Path) -> None:
    """recording.parquet, query.parquet and truth.json in a folder.

    truth.json: {kind, seed, effects, scopes, snr, snr_given_others, outside, rig, true (the skin),
    noise_V (M), level, query_voltage_V (Q x M, noise-free)}.
    """
    folder = Path(folder)
    parts = {"recording": (case.states, case.voltage), "query": (case.query, None)}
    for name, (frames, voltage) in parts.items():
        made = recording.Recording(frames, voltage, None, None, case.metadata)
        recording.write(made, folder / f"{name}.parquet")
    truth = {
        "kind": case.kind,
        "seed": case.seed,
        "effects": case.effects,
        "scopes": case.scopes,
        "snr": case.snr,
        "snr_given_others": case.snr_given_others,
        "outside": case.outside,
        "rig": [{"kind": error.kind, "size": error.size} for error in case.rig],
        "true": case.true.metadata(),
        "noise_V": case.noise_V.tolist(),
        "level": case.level,
        "query_voltage_V": case.query_clean.tolist(),
    }
    with atomic_path(folder / "truth.json") as path:
        path.write_text(json.dumps(truth, indent=1), encoding="utf-8")

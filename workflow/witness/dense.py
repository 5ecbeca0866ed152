"""Recordings of skins that are a little wrong at every site, with known truth.

    draw("dense:16 adjacent", 3), draw("dense:16 skip-3 object", 7), draw("pressed:16 adjacent", 2)

Nobody touches, or the skin is pressed all over. All families at once, each of a size of its own:
currents of drives, gains of pairs, electrodes' places, widths and contacts, the rim's harmonics, a
memory of the multiplexer; half the recordings have a culprit beside them, a site that stands out of
its family, or an object in the gel. No line is shared with the diagnosis. Equal kinds and seeds
give the same recording bit for bit.
"""

from dataclasses import dataclass, replace
from zlib import crc32

import numpy as np

from eitskin.data.recording import Recording
from eitskin.errors import InputError
from eitskin.physics.protocol import channel_table
from eitskin.physics.skin import Skin
from witness.cases import log_uniform, owners_metadata
from witness.schedule import Keep, recording_frames, untouched_frames
from witness.world import World

PROTOCOLS = ("8 adjacent", "16 adjacent", "16 opposite", "16 skip-3", "32 adjacent")
ENDINGS = ("", " member", " members", " object")  # what stands out
OBJECTS = " objects"  # an ending that is no turn of ENDINGS: several objects, apart
PRESSED = "pressed:"  # instead of dense:, where the skin is touched; without objects
PRESSED_FRAMES = (60, 200)
# Ranges of the families' sds: 1, degrees, logarithms, share of the radius of a harmonic.
SIZES = {
    "drive-gain": (2e-3, 0.2),
    "measurement-gain": (2e-3, 0.2),
    "electrode-position": (0.05, 1.5),
    "electrode-width": (0.01, 0.15),
    "contact-impedance": (0.05, 0.7),
    "rim-modes": (3e-4, 0.02),
}
MEMORY = (1e-4, 0.03)  # of the multiplexer
HARMONICS = (2, 3, 4, 5)
RATIO = (3.0, 30.0)  # of a culprit's deviation over its family's sd
GAIN_CAP, PITCH_CAP, CONTACT_CAP = 0.5, 0.4, np.log(100.0)
LEAST_GAP = 0.15  # of the pitch, between neighbouring electrodes
RADII, REACH = (0.12, 0.22), 0.7  # of objects, and of their places, shares of the skin's radius
CONTRASTS = (0.05, 20.0)  # insulating and conducting objects
OBJECT_COUNTS, OBJECT_GAP = (2, 3, 4), 0.1  # of OBJECTS; the gap between them in radii of the skin
LEVELS = (1e-5, 1e-3)  # of the noise over the median |v|
FRAMES = (1, 30)
CULPRITS = ("electrode-position", "contact-impedance", "drive-gain", "measurement-gain")
SITES = {"drive-gain": "drives", "measurement-gain": "measures"}


@dataclass(frozen=True)
class Dense:
    """A recording and its truth: the skin's true values, the families' values, one a site, in the
    units of SIZES; culprits: laws with `ratio`, their deviation over the family's sd; objects: laws
    of patches; clean (N, M) V: the readings, noise-free, of one frame where all are alike."""

    kind: str
    seed: int
    recorded: Recording
    true: Skin
    families: dict[str, np.ndarray]
    culprits: list[dict]
    objects: list[dict]
    memory: float
    clean: np.ndarray


def draw(kind: str, seed: int) -> Dense:
    """One recording. kind: dense: or PRESSED, one of PROTOCOLS and one of ENDINGS or OBJECTS.
    Raises InputError for another."""
    pressed = kind.startswith(PRESSED)
    electrodes, _, rest = kind.removeprefix(PRESSED if pressed else "dense:").partition(" ")
    protocol, _, ending = rest.partition(" ")
    endings = [e for e in (*ENDINGS, OBJECTS) if not (pressed and e.startswith(" object"))]
    if f"{electrodes} {protocol}" not in PROTOCOLS or f" {ending}".rstrip() not in endings:
        expected = f"dense: or {PRESSED}, one of {', '.join(PROTOCOLS)} and one of"
        raise InputError("dense", "kind", repr(kind), f"{expected} {', '.join(endings)}")
    rng = np.random.default_rng([crc32(kind.encode()), seed])
    count = int(electrodes)
    while True:
        believed = _skin(rng, count)
        families = {name: _members(rng, name, count) for name in SIZES}
        culprits = _culprits(rng, families, {"member": 1, "members": 2}.get(ending, 0))
        if _fits(believed, families):
            break
    several = f" {ending}" == OBJECTS
    object_count = rng.choice(OBJECT_COUNTS) if several else int(ending == "object")
    objects = _objects(rng, believed, int(object_count))
    memory = log_uniform(rng, *MEMORY)
    laws = [*_laws(families, believed), *objects]
    laws.append({"name": "multiplexer-memory", "parameters": {"mu": memory}})
    channels = channel_table(count, protocol, "adjacent")
    if pressed:
        assert believed.radius_mm is not None
        frames = int(rng.integers(*PRESSED_FRAMES))
        states = recording_frames(rng, believed.radius_mm, 0.04, Keep(), frames)
        clean = World(believed, channels, 0.04).readings(states, laws)
    else:
        frames = int(rng.choice(FRAMES))
        states = untouched_frames(frames, 0.05)
        clean = World(believed, channels, 0.04).readings(states.iloc[:1], laws)
    noise = log_uniform(rng, *LEVELS) * float(np.median(np.abs(clean)))
    voltage = clean + noise * rng.standard_normal((frames, len(channels)))
    metadata = owners_metadata(channels, 0.04, _stated(rng, believed))
    return Dense(
        kind,
        seed,
        Recording(states, voltage, None, None, metadata),
        believed,
        families,
        culprits,
        objects,
        memory,
        clean,
    )


def _skin(rng: np.random.Generator, count: int) -> Skin:
    radius_mm = round(float(rng.uniform(50.0, 100.0)), 1)
    pitch_mm = 2.0 * np.pi * radius_mm / count
    return Skin(
        radius_mm=radius_mm,
        thickness_mm=round(float(rng.uniform(2.0, 4.0)), 2),
        conductivity_S_per_m=round(float(rng.uniform(0.2, 1.0)), 3),
        electrode_deg=tuple((360.0 / count * np.arange(count)).tolist()),
        electrode_width_mm=round(float(rng.uniform(0.2, 0.5)) * pitch_mm, 2),
        contact_impedivity_ohm_m2=log_uniform(rng, 5e-4, 1e-2),
        current_A=log_uniform(rng, 1e-4, 5e-3),
        contrast_per_N=0.5,
    )


def _stated(rng: np.random.Generator, skin: Skin) -> Skin:
    """The skin as its owner states it: all of it, or only its size and electrodes, or nothing."""
    known = int(rng.integers(3))
    if known == 0:
        return skin
    values = {"conductivity_S_per_m": None, "contact_impedivity_ohm_m2": None}
    values |= {"contrast_per_N": None, "current_A": None}
    if known == 2:
        values |= {"radius_mm": None, "thickness_mm": None, "electrode_width_mm": None}
    return replace(skin, **values)


def _members(rng: np.random.Generator, name: str, count: int) -> np.ndarray:
    """(n,): the values of a family, of the rim (2, 4) cosine and sine amplitudes."""
    sd = log_uniform(rng, *SIZES[name])
    shape = (2, len(HARMONICS)) if name == "rim-modes" else (count,)
    return sd * rng.standard_normal(shape)


def _culprits(rng: np.random.Generator, families: dict[str, np.ndarray], number: int) -> list[dict]:
    """Sites that are made to stand out of their families, which `families` then hold."""
    culprits = []
    for name in rng.permutation(CULPRITS)[:number]:
        values = families[str(name)]
        sd = float(np.sqrt(np.mean(values**2)))
        site = int(rng.integers(len(values)))
        cap = {"electrode-position": PITCH_CAP * 360.0 / len(values)}.get(
            str(name), CONTACT_CAP if name == "contact-impedance" else GAIN_CAP
        )
        deviation = float(rng.choice([-1.0, 1.0])) * min(log_uniform(rng, *RATIO) * sd, cap)
        values[site] = deviation
        culprits.append(
            {"name": str(name), "site": site, "value": deviation, "ratio": abs(deviation) / sd}
        )
    return culprits


def _fits(skin: Skin, families: dict[str, np.ndarray]) -> bool:
    """Whether neighbouring electrodes keep LEAST_GAP of the pitch between them."""
    assert skin.radius_mm is not None and skin.electrode_width_mm is not None
    deg = np.array(skin.electrode_deg) + families["electrode-position"]
    half = np.degrees(
        0.5 * skin.electrode_width_mm * np.exp(families["electrode-width"]) / skin.radius_mm
    )
    gaps = np.diff(np.r_[deg, deg[0] + 360.0]) - half - np.roll(half, -1)
    return bool(gaps.min() > LEAST_GAP * 360.0 / len(deg))


def _objects(rng: np.random.Generator, skin: Skin, count: int) -> list[dict]:
    """So many discs, apart from one another."""
    assert skin.radius_mm is not None
    objects: list[dict] = []
    while len(objects) < count:
        new = _object(rng, skin)
        if all(_gap_mm(new, other) > OBJECT_GAP * skin.radius_mm for other in objects):
            objects.append(new)
    return objects


def _gap_mm(a: dict, b: dict) -> float:
    a, b = a["parameters"], b["parameters"]
    distance = np.hypot(a["x_mm"] - b["x_mm"], a["y_mm"] - b["y_mm"])
    return float(distance - a["radius_mm"] - b["radius_mm"])


def _object(rng: np.random.Generator, skin: Skin) -> dict:
    """A disc of another conductivity."""
    assert skin.radius_mm is not None
    place = skin.radius_mm * REACH * np.sqrt(rng.uniform()) * np.exp(2j * np.pi * rng.uniform())
    values = {
        "x_mm": float(place.real),
        "y_mm": float(place.imag),
        "radius_mm": float(skin.radius_mm * rng.uniform(*RADII)),
        "contrast": float(rng.choice(CONTRASTS)),
    }
    return {"name": "conductivity-patch", "parameters": values}


def _laws(families: dict[str, np.ndarray], skin: Skin) -> list[dict]:
    """The families as laws."""
    assert skin.electrode_width_mm is not None
    everywhere = list(range(len(families["electrode-position"])))
    values = {
        "drive-gain": ("gain", 1.0 + families["drive-gain"]),
        "measurement-gain": ("gain", 1.0 + families["measurement-gain"]),
        "electrode-position": ("shift_deg", families["electrode-position"]),
        "electrode-width": (
            "width_mm",
            skin.electrode_width_mm * np.exp(families["electrode-width"]),
        ),
        "contact-impedance": ("ratio", np.exp(families["contact-impedance"])),
    }
    laws: list[dict] = [
        {
            "name": name,
            SITES.get(name, "electrodes"): everywhere,
            "parameters": {key: amounts.tolist()},
        }
        for name, (key, amounts) in values.items()
    ]
    for harmonic, amplitude in zip(HARMONICS, families["rim-modes"].T, strict=True):
        cosine, sine = (float(part) for part in amplitude)
        parameters = {
            "harmonic": harmonic,
            "amplitude": float(np.hypot(cosine, sine)),
            "phase_deg": float(np.degrees(np.arctan2(sine, cosine))),
        }
        laws.append({"name": "domain-shape", "parameters": parameters})
    return laws

"""Draw the cases of a block: recordings and queries for everybody, truths under lock.

How plain a case is is set by its noise: the gaps that the true set has to every other name are
judged on the noise-free recording, and the noise is scaled until the smallest is the wanted one.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from eitskin.atomic import atomic_path
from eitskin.data import recording
from eitskin.data.recording import Recording, frames_table
from eitskin.errors import InputError
from proof import ledger, sealing
from proof.drawing import draw
from proof.intervals import rms
from proof.panel import RECORDED, Planned, plan
from proof.planted import Planted
from proof.refit import Gaps, gaps_in_noise
from proof.resemblance import moves
from witness import rig_errors
from witness.cases import Blinding, Case
from witness.generators import GENERATORS

LEAST_LEVEL, MOST_LEVEL = 2e-4, 3e-2  # noise over the median |v|, of good and of poor instruments
NEAR = 0.1  # of the wanted gap: no more is asked of the reached one
ROUNDS = 2  # in which the noise is scaled: a gap falls nearly as the noise grows


@dataclass(frozen=True)
class Sizes:
    """Frames of every simulated recording and query, cases of the block, and whether the rigs that
    recorded them have errors of their own."""

    cases: int
    frames: int
    query_frames: int
    rig: bool = False


@dataclass(frozen=True)
class Block:
    """A block to conceal: its folder of recordings and that of its truths, the seed of its root
    (None: a random one), and the fingerprint of what draws it."""

    name: str
    sizes: Sizes
    seed: int | None
    public: Path
    truths: Path
    code: str


@dataclass(frozen=True)
class Shown:
    """A case as it is shown: voltage (N, M) V with noise noise_V (M,) of `level` over the median
    |v|; gaps: as `refit.true_gaps`, None where there are none to judge."""

    voltage: np.ndarray
    noise_V: np.ndarray
    level: float
    gaps: Gaps | None


def case_of(planned: Planned, sizes: Sizes) -> Case | Planted:
    """What a plan draws, with the noise that its generator gave it."""
    if planned.generator == RECORDED:
        return draw(planned.kind, planned.seed)
    return draw(
        planned.kind + ("+rig" if sizes.rig else ""),
        planned.seed,
        frames=sizes.frames,
        generator=planned.generator,
        names=None if planned.names is None else list(planned.names),
        blinding=Blinding(sizes.query_frames, planned.deep, (LEAST_LEVEL, MOST_LEVEL)),
    )


def shown(case: Case | Planted, planned: Planned, root: bytes, name: str) -> Shown:
    """The case at the noise at which its smallest gap is the wanted one, as near as 0.02 % to 3 %
    of the median |v| allow and as the covariance's other parts do; without a wanted gap at the
    level that was drawn for it. A real recording stays as it is."""
    if case.clean is None:
        return Shown(case.voltage, case.noise_V, case.level, None)
    least_level = max(LEAST_LEVEL, GENERATORS[planned.generator].least_level)
    shape, gaps = case.noise_V / case.level, None
    level = float(np.clip(case.level, least_level, MOST_LEVEL))
    if planned.gap is not None:
        for _ in range(ROUNDS):
            gaps = gaps_in_noise(case, shape * level)
            nearest = smallest(gaps)
            if nearest is None or abs(nearest / planned.gap - 1.0) < NEAR:
                break
            level_wanted = float(np.clip(level * nearest / planned.gap, least_level, MOST_LEVEL))
            if level_wanted == level:
                break
            level, gaps = level_wanted, None
    noise = shape * level
    if gaps is None:
        gaps = gaps_in_noise(case, noise)
    rng = np.random.default_rng(int.from_bytes(sealing.derived(root, "noise", name)))
    voltage = rig_errors.read(case.clean, case.rig, case.true_states, noise, rng)
    return Shown(voltage, noise, level, gaps)


def smallest(gaps: Gaps | None) -> float | None:
    """The smallest gap of a set's effects to any other name; None where none is known."""
    return min((pairs[0][1] for pairs in gaps or [] if pairs), default=None)


def likeness(case: Case | Planted, seen: Shown, seed: int) -> dict:
    """How little the effects show: similarity, as `resemblance.moves` has it, and changed: RMS of
    what they change, an overall factor taken away, over that of the readings without them. None
    each of a real recording, which nobody knows without."""
    if case.clean is None:
        return {"similarity": None, "changed": None}
    plain = case.world.readings(case.true_states, [])
    plain = np.abs(plain) if rig_errors.magnitudes(case.rig) else plain
    factor = float((plain * case.clean).sum() / (plain**2).sum())
    return {
        "similarity": moves(seen.voltage, plain, case.clean, seen.noise_V, seed),
        "changed": rms(case.clean - factor * plain) / rms(plain),
    }


def truth_of(
    name: str, planned: Planned, case: Case | Planted, seen: Shown
) -> tuple[dict, dict[str, np.ndarray]]:
    """What is put under lock: a JSON object, and the arrays noise_V (M,) and, of a simulated case,
    clean_V (N, M) and query_clean_V (Q, M)."""
    louder = seen.level / case.level
    outside = case.outside and {**case.outside, "snr": case.outside["snr"] / louder}
    truth = {
        "case": name,
        "generator": planned.generator,
        "kind": planned.kind,
        "seed": planned.seed,
        "effects": case.effects,
        "scopes": case.scopes,
        "snr": [snr / louder for snr in case.snr],
        "snr_given_others": [snr / louder for snr in case.snr_given_others],
        "outside": outside,
        "fault": getattr(case, "fault", None),
        "rig": [{"kind": error.kind, "size": error.size} for error in case.rig],
        "gaps": seen.gaps,
        "gap_wanted": planned.gap,
        "gap_reached": smallest(seen.gaps),
        "deep": planned.deep,
        "true": None if case.true is None else case.true.metadata(),
        "noise_V": seen.noise_V.tolist(),
        "level": seen.level,
        **likeness(case, seen, planned.seed),
    }
    arrays = {"noise_V": seen.noise_V}
    if case.clean is not None:
        arrays |= {"clean_V": case.clean, "query_clean_V": case.query_clean}
    return truth, arrays


def conceal(block: Block, names: list[str]) -> dict[str, dict]:
    """Draw cases of a block and return their commitments by name.

    Written are recordings/<name>.parquet and queries/<name>.parquet in its public folder,
    <name>.sealed in that of its truths. What is there already stays, if the same code drew it or if
    the block's root is random: such a block is drawn once.
    """
    if sealing.complete(block.seed, block.truths):
        promised = sealing.check_commitments(block.public)["cases"]
        return {name: promised[name] for name in names}
    root = sealing.root_of(block.name, block.seed, block.truths)
    planned = plan(block.name, block.sizes.cases, root)
    commitments = {}
    for name in names:
        files = ledger.files_of(block.public, name)
        sealed = block.truths / f"{name}.sealed"
        plain = _standing(block, root, name, [*files.values(), sealed])
        if plain is None:
            plain = _draw(block, root, name, planned[name])
            with atomic_path(sealed) as temporary:
                temporary.write_bytes(sealing.seal_truth(root, block.name, name, plain))
        commitments[name] = sealing.commitment(root, name, files, plain)
    return commitments


def _standing(block: Block, root: bytes, name: str, files: list[Path]) -> bytes | None:
    """The packed truth of a case that need not be drawn again."""
    if not all(file.is_file() for file in files):
        return None
    try:
        key = sealing.derived(root, "key")
        plain = sealing.open_truth(key, block.name, name, files[-1])
    except InputError:  # another root's
        return None
    code = json.loads(sealing.unpacked(plain)[0])["code"]
    return plain if block.seed is None or code == block.code else None


def _draw(block: Block, root: bytes, name: str, planned: Planned) -> bytes:
    case = case_of(planned, block.sizes)
    seen = shown(case, planned, root, name)
    query = case.query
    if query.empty:  # no frame of a real recording is left: an untouched one, a second later
        query = frames_table(case.states["time_s"].to_numpy()[-1:] + 1.0, np.array([False]))
    files = ledger.files_of(block.public, name)
    for part, frames, voltage in (
        ("recording", case.states, seen.voltage),
        ("query", query, None),
    ):
        recording.write(Recording(frames, voltage, None, None, case.metadata), files[part])
    truth, arrays = truth_of(name, planned, case, seen)
    salt = sealing.derived(root, "salt", name, "truth").hex()
    return sealing.packed({**truth, "salt": salt, "code": block.code}, arrays)

"""Draw the cases of a block: recordings and queries for everybody, truths under lock.

How plain a case is is set by its noise: the gaps that the true set has to every other name are
judged on the noise-free recording, and the noise is scaled until the smallest is the wanted one.
"""

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calibration.intervals import rms
from calibration.trial import gaps_about
from concealed import planted, sealing
from concealed.panel import RECORDED, Planned, plan
from concealed.resemblance import moves
from eitskin.atomic import atomic_path
from eitskin.data import recording
from eitskin.data.recording import Recording, frames_table
from eitskin.diagnose.diagnosis import begun, problem_of
from eitskin.diagnose.noise.estimate import Noise
from eitskin.errors import InputError
from eitskin.physics.solver import Spent
from witness import rig_errors
from witness.cases import Blinding, Case, draw
from witness.generators import GENERATORS

LEAST_LEVEL, MOST_LEVEL = 2e-4, 3e-2  # noise over the median |v|
NEAR = 0.1  # of the wanted gap: no more is asked of the reached one
ROUNDS = 2
KNOWN_DOF = 1e9  # of a noise that is known
MOST_SOLVED = 24_000  # sheets, for the gaps of one case


@dataclass(frozen=True)
class Sizes:
    """Frames of every simulated recording and query, cases of the block, and whether the rigs that
    recorded them have errors of their own."""

    cases: int
    frames: int
    query_frames: int
    rig: bool = False


@dataclass(frozen=True)
class Shown:
    """A case as it is shown: voltage (N, M) V with noise noise_V (M,) of `level` over the median
    |v|; gaps: as `calibration.trial.true_gaps`, None where there are none to judge."""

    voltage: np.ndarray
    noise_V: np.ndarray
    level: float
    gaps: list | None


def case_of(planned: Planned, sizes: Sizes) -> Case | planted.Planted:
    """What a plan draws, with the noise that its generator gave it."""
    if planned.generator == RECORDED:
        return planted.draw(planned.kind, planned.seed)
    names = None if planned.names is None else list(planned.names)
    alike = Blinding(sizes.query_frames, planned.deep, (LEAST_LEVEL, MOST_LEVEL))
    kind = planned.kind + ("+rig" if sizes.rig else "")
    return draw(kind, planned.seed, sizes.frames, planned.generator, names, alike)


def shown(case: Case | planted.Planted, planned: Planned, root: bytes, name: str) -> Shown:
    """The case at the noise at which its smallest gap is the wanted one, as near as 0.02 % to 3 %
    of the median |v| allow and as the covariance's other parts do; without a wanted gap at the
    level that was drawn for it. A real recording stays as it is."""
    if case.clean is None:
        return Shown(case.voltage, case.noise_V, case.level, None)
    least = max(LEAST_LEVEL, GENERATORS[planned.generator].least_level)
    shape, gaps = case.noise_V / case.level, None
    level = float(np.clip(case.level, least, MOST_LEVEL))
    if planned.gap is not None:
        for _ in range(ROUNDS):
            gaps = gaps_at(case, shape * level)
            nearest = smallest(gaps)
            if nearest is None or abs(nearest / planned.gap - 1.0) < NEAR:
                break
            wanted = float(np.clip(level * nearest / planned.gap, least, MOST_LEVEL))
            if wanted == level:
                break
            level, gaps = wanted, None
    noise = shape * level
    if gaps is None:
        gaps = gaps_at(case, noise)
    rng = np.random.default_rng(int.from_bytes(sealing.derived(root, "noise", name)))
    voltage = rig_errors.read(case.clean, case.rig, case.true_states, noise, rng)
    return Shown(voltage, noise, level, gaps)


def smallest(gaps: list | None) -> float | None:
    """The smallest gap of a set's effects to any other name; None where none is known."""
    found = [listed[0][1] for listed in gaps or [] if listed]
    return min(found, default=None)


def gaps_at(case: Case, noise_V: np.ndarray) -> list | None:
    """`calibration.trial.true_gaps` of a case's effects in noise (M,) V, on its noise-free
    recording; None of one without effects, or where they take more than MOST_SOLVED."""
    if not case.effects:
        return None
    clean = Recording(case.true_states, case.clean, None, None, dict(case.metadata))
    _, search, _ = begun(clean, 1)
    problem, _ = problem_of(clean, Noise(noise_V, KNOWN_DOF, "known"))
    search = replace(search, problem=problem)
    try:
        with problem.model.near.within(MOST_SOLVED):
            before = search.calibrated()
            return gaps_about(search, before, before, [], case.effects, case.scopes)
    except Spent:
        return None


def likeness(case: Case | planted.Planted, seen: Shown, seed: int) -> dict:
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
    name: str, planned: Planned, case: Case | planted.Planted, seen: Shown, salt: str, code: str
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
        "salt": salt,
        "code": code,
    }
    arrays = {"noise_V": seen.noise_V}
    if case.clean is not None:
        arrays |= {"clean_V": case.clean, "query_clean_V": case.query_clean}
    return truth, arrays


def conceal(
    block: str,
    names: list[str],
    sizes: Sizes,
    seed: int | None,
    public: Path,
    truths: Path,
    code: str,
) -> dict[str, dict]:
    """Draw cases of a block and return their commitments by name.

    Written are recordings/<name>.parquet and queries/<name>.parquet in `public`, <name>.sealed in
    `truths`. What is there already stays, if the same `code` drew it or if the block's root is
    random (seed None): such a block is drawn once.
    """
    if sealing.complete(seed, truths):
        known = sealing.check_commitments(public)["cases"]
        return {name: known[name] for name in names}
    root = sealing.root_of(block, seed, truths)
    planned = plan(block, sizes.cases, root)
    made = {}
    for name in names:
        files = public / "recordings" / f"{name}.parquet", public / "queries" / f"{name}.parquet"
        sealed = truths / f"{name}.sealed"
        plain = _kept(root, block, name, [*files, sealed], seed is None, code)
        if plain is None:
            plain = _draw(root, name, planned[name], sizes, files, code)
            with atomic_path(sealed) as temporary:
                temporary.write_bytes(sealing.seal_truth(root, block, name, plain))
        made[name] = sealing.commitment(root, name, *files, plain)
    return made


def _kept(
    root: bytes, block: str, name: str, files: list[Path], once: bool, code: str
) -> bytes | None:
    """The packed truth of a case that need not be drawn again."""
    if not all(file.is_file() for file in files):
        return None
    try:
        plain = sealing.open_truth(sealing.derived(root, "key"), block, name, files[-1])
    except InputError:  # another root's
        return None
    drawn_by = json.loads(sealing.unpacked(plain)[0])["code"]
    return plain if once or drawn_by == code else None


def _draw(
    root: bytes, name: str, planned: Planned, sizes: Sizes, files: tuple[Path, Path], code: str
) -> bytes:
    case = case_of(planned, sizes)
    seen = shown(case, planned, root, name)
    query = case.query
    if query.empty:  # no frame of a real recording is left: an untouched one, a second later
        query = frames_table(case.states["time_s"].to_numpy()[-1:] + 1.0, np.array([False]))
    for path, frames, voltage in zip(
        files, (case.states, query), (seen.voltage, None), strict=True
    ):
        recording.write(Recording(frames, voltage, None, None, case.metadata), path)
    salt = sealing.derived(root, "salt", name, "truth").hex()
    return sealing.packed(*truth_of(name, planned, case, seen, salt, code))

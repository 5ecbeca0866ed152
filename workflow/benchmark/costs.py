"""What a skin costs against its electrodes; a diagnosis against frames, electrodes and names."""

import os
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import yaml

from benchmark import diagnoses, rows
from eitskin import effects
from eitskin.data import recording, subset
from eitskin.physics.accuracy import untouched_error
from eitskin.physics.forward import ACCURACIES, Forward
from eitskin.physics.geometry import Geometry
from eitskin.physics.protocol import channel_table
from eitskin.physics.sheets import Sheets
from eitskin.physics.touch import Touch
from eitskin.progress import patient
from eitskin.simulate import twin
from eitskin.simulate.layout import polar_grid
from witness import cases

ELECTRODES = (16, 32, 64)
TOUCH = [Touch(20.0, 31.0, 5.0, contrast=4.0)]
GRID = polar_grid(80.0, 8, 24, 0.095, 0.855, 0.0)
PLACES_MM = [(x, y, 5.0) for x, y in zip(GRID["x_mm"], GRID["y_mm"], strict=True)]
CONTRASTS = np.linspace(0.9, 9.0, 5)
SKINS, GPU_SKINS = 16, 256  # at once
SAMPLES = SKINS * len(PLACES_MM) * len(CONTRASTS)
SAMPLES_A_SECOND = 1e6
ERROR = 1e-3  # of the median |v|, the noise of a very good rig
SOLVES = 5
CORES = 2  # of a diagnosis
LEFT_OUT = "contact-impedance"
KIND = f"single:{LEFT_OUT}+rig"
FRAMES = (100, 200, 500, 1000)
SOME = 200  # frames of a diagnosis against names
GROWN = 50  # frames by which a recording grows


def skin(electrodes: int, number: int) -> Geometry:
    """The paper's disc with so many electrodes, at angles of its own."""
    off = np.random.default_rng([electrodes, number]).normal(0.0, 0.1, electrodes)
    angles = 360.0 / electrodes * np.arange(electrodes) + off
    each = np.ones(electrodes)
    return Geometry(80.0, 3.0, 0.5, angles, 5.0 * each, 2e-3 * each)


def electrodes(runs: int) -> list[dict]:
    """New skins of 16, 32 and 64 electrodes, adjacent: processor seconds of one pressed at all
    places with five forces; of the derivatives of everything, beside five solves of a touched skin;
    the error of untouched voltages, beside what noise allows."""
    pressed: dict[int, list[float]] = {}
    told = []
    for count in patient(ELECTRODES, "electrodes"):
        channels = channel_table(count)
        pressed[count] = _seconds(partial(_press, channels=channels), count, runs)
        name = f"new skin of {count} electrodes, 192 places"
        first = pressed[ELECTRODES[0]]
        told.append(rows.row(name, "s", pressed[count], f"{ELECTRODES[0]} electrodes", first))
        for accuracy in ACCURACIES:
            title = f"{count} electrodes, {accuracy}"
            once = _seconds(partial(_solve, channels=channels, accuracy=accuracy), count, runs)
            slopes = _seconds(partial(_slopes, accuracy=accuracy), count, runs)
            five = [SOLVES * one for one in once]
            told.append(rows.row(f"derivatives, {title}", "s", slopes, "five solves", five))
            errors = [_error(skin(count, run), channels, accuracy) for run in range(runs)]
            told.append(rows.row(f"error, {title}", "of median |v|", errors, "limit", [ERROR]))
    return told


def together(runs: int) -> list[dict]:
    """Samples of SKINS new skins, each pressed at all places with five forces. A processor second
    on one core, all skins at once, on NumPy and on PyTorch, beside one by one; where there is a
    GPU, a second by the clock on it, beside a mark."""
    import torch  # here, as the other benches' memory is counted without it

    torch.set_num_threads(1)
    channels = channel_table(ELECTRODES[0])
    ways: dict[str, Callable[[list[Geometry]], object]] = {
        "one by one": partial(_press_each, channels=channels),
        "new skins at once, NumPy": partial(_press_all, channels=channels, device=None),
        "new skins at once, PyTorch": partial(_press_all, channels=channels, device="cpu"),
    }
    found: dict[str, list[float]] = {name: [] for name in ways}
    for run in patient(range(runs + 1), "together, runs"):
        several = [skin(ELECTRODES[0], SKINS * run + k) for k in range(SKINS)]
        for name, way in ways.items():
            start = time.process_time()
            way(several)
            found[name].append(SAMPLES / (time.process_time() - start))
    (peer, alone), *ours = ((name, rates[1:]) for name, rates in found.items())
    told = [rows.row(name, "samples/s", rates, peer, alone) for name, rates in ours]
    if torch.cuda.is_available():
        rates = [_on_gpu(channels, run) for run in range(runs + 1)][1:]
        name = f"new skins at once, {torch.cuda.get_device_name()}"
        told.append(rows.row(name, "samples/s", rates, "mark", [SAMPLES_A_SECOND]))
    return told


def _on_gpu(channels: np.ndarray, run: int) -> float:
    import torch  # as in `together`

    several = [skin(ELECTRODES[0], GPU_SKINS * run + k) for k in range(GPU_SKINS)]
    start = time.perf_counter()
    _press_all(several, channels, "cuda")
    torch.cuda.synchronize()
    return SAMPLES / SKINS * GPU_SKINS / (time.perf_counter() - start)


def _press_all(several: list[Geometry], channels: np.ndarray, device: str | None) -> None:
    Sheets(several, "train", device).channel_change(PLACES_MM, channels, CONTRASTS)


def _press_each(several: list[Geometry], channels: np.ndarray) -> None:
    for geometry in several:
        _press(geometry, channels)


def _press(geometry: Geometry, channels: np.ndarray) -> None:
    for modes in Forward(geometry, "train").places(PLACES_MM):
        modes.channel_change(channels, CONTRASTS)


def _solve(geometry: Geometry, channels: np.ndarray, accuracy: str) -> None:
    Forward(geometry, accuracy).voltages(channels, TOUCH)


def _slopes(geometry: Geometry, accuracy: str) -> None:
    Forward(geometry, accuracy).derivatives(TOUCH)


def _seconds(work: Callable[[Geometry], None], count: int, runs: int) -> list[float]:
    """Processor seconds, a new skin each run; a first one that only warms up is not counted."""
    found = []
    for run in range(runs + 1):
        geometry = skin(count, run)
        start = time.process_time()
        work(geometry)
        found.append(time.process_time() - start)
    return found[1:]


def _error(geometry: Geometry, channels: np.ndarray, accuracy: str) -> float:
    """Root mean square error of untouched voltages, of their median size."""
    error = untouched_error(geometry, channels, accuracy)
    size = np.median(np.abs(Forward(geometry, accuracy).voltages(channels)))
    return float(np.sqrt((error**2).mean()) / size)


def drawn(seed: int, frames: int, names: int) -> float:
    """Seconds of the diagnosis of a drawn recording of KIND, with so many names left in the
    catalogue, that of the recording's truth among them: call it in a fresh process."""
    others = [name for name in effects.catalogue_names() if name != LEFT_OUT]
    for name in others[names - 1 :]:
        del effects.EFFECTS[name]
    return diagnoses.diagnose(KIND, seed, frames, CORES)[0]


def twinned(seed: int, count: int) -> float:
    """Seconds of the diagnosis of `config.yaml`'s twin with so many electrodes and six presses:
    call it in a fresh process."""
    given = yaml.safe_load((rows.ROOT / "config.yaml").read_text(encoding="utf-8"))["twin"]
    given["skin"]["electrode_deg"] = (360.0 / count * np.arange(count)).tolist()
    given["touch_grid"] |= {"radii": 2, "angles": 3}
    given["press"] |= {"probes_mm": [10.0], "sessions_per_probe": 1}
    with TemporaryDirectory() as folder:
        path = Path(folder) / "twin.parquet"
        twin.write(path, twin.Twin(**given | {"seed": seed}))
        return begun(path)


def begun(path: Path, *options: str) -> float:
    """Seconds of `eitskin diagnose` of a recording, with options, on CORES: call it in a fresh
    process."""
    os.environ["OMP_NUM_THREADS"] = str(CORES)
    return diagnoses.diagnosis(path, *options)[0]


def grown(runs: int) -> list[dict]:
    """Seconds by the clock of diagnoses of recordings of KIND that have grown by GROWN frames, with
    the effects that they had before to begin with, beside begun anew. Each run has its own."""
    found: dict[bool, list[float]] = {False: [], True: []}
    for run in patient(range(1, runs + 1), "grown, runs"):
        whole = cases.draw(KIND, run, diagnoses.FRAMES + GROWN).recorded
        with TemporaryDirectory() as folder:
            path = Path(folder) / "drawn.parquet"
            recording.write(subset.stretch(whole, 0, diagnoses.FRAMES - 1, str(path)), path)
            _fresh(begun, path)
            effects_file = Path(folder) / "effects.yaml"
            path.with_name("out").joinpath("effects.yaml").replace(effects_file)
            recording.write(whole, path)
            for earlier, seconds in found.items():
                options = ["--earlier", str(effects_file)] if earlier else []
                seconds.append(_fresh(begun, path, *options))
    name = f"diagnosis, {GROWN} frames more, begun with what was found"
    return [rows.row(name, "s", found[True], "begun anew", found[False])]


def _fresh(work: Callable[..., float], *given: object) -> float:
    """What a function returns in a process of its own."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(work, *given).result()


def scaled(runs: int) -> list[dict]:
    """Seconds by the clock of diagnoses on two cores: against frames, electrodes, and the number of
    names. Each run has recordings of its own."""
    whole = len(effects.catalogue_names())
    names = whole // 4, whole // 2, whole
    groups: tuple[tuple[str, dict[str, tuple]], ...] = (
        (f"{diagnoses.FRAMES} frames", {f"{n} frames": (drawn, n, whole) for n in FRAMES}),
        (
            f"six presses, {ELECTRODES[0]} electrodes",
            {f"six presses, {n} electrodes": (twinned, n) for n in ELECTRODES[:2]},
        ),
        (
            f"{SOME} frames, {whole} names",
            {f"{SOME} frames, {n} names": (drawn, SOME, n) for n in names},
        ),
    )
    jobs = {name: job for _, group in groups for name, job in group.items()}
    found: dict[str, list[float]] = {name: [] for name in jobs}
    for run in range(1, runs + 1):
        for name in patient(list(jobs), f"scaled, run {run} of {runs}"):
            work, *given = jobs[name]
            found[name].append(_fresh(work, run, *given))
    return [
        rows.row(f"diagnosis, {name}", "s", found[name], peer, found[peer])
        for peer, group in groups
        for name in group
    ]

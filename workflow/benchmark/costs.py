"""The cost of a skin by its electrodes; of a diagnosis by frames, electrodes and names."""

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
SKINS, GPU_SKINS = 16, 256  # solved at once: as many as fill a core's caches, and a GPU
SAMPLES = SKINS * len(PLACES_MM) * len(CONTRASTS)
SAMPLES_A_SECOND = 1e6  # the aim on a GPU
ERROR = 1e-3  # of the median |v|, the noise of a very good rig
SOLVES = 5  # whose time all derivatives together may take
CORES = 2  # of a diagnosis
CONCEALED = "contact-impedance"
KIND = f"single:{CONCEALED}+rig"
FRAMES = (100, 200, 500, 1000)
NAMES_FRAMES = 200  # frames of a diagnosis with fewer names
GROWN = 50  # frames by which a recording grows


def skin(electrodes: int, number: int) -> Geometry:
    """The paper's disc with so many electrodes, at angles drawn for its number."""
    angle_errors = np.random.default_rng([electrodes, number]).normal(0.0, 0.1, electrodes)
    angles = 360.0 / electrodes * np.arange(electrodes) + angle_errors
    per_electrode = np.ones(electrodes)
    return Geometry(80.0, 3.0, 0.5, angles, 5.0 * per_electrode, 2e-3 * per_electrode)


def electrodes(runs: int) -> list[dict]:
    """New skins of 16, 32 and 64 electrodes, adjacent drive: processor seconds of one pressed at
    all places with five forces; of all derivatives, beside five solves of a touched skin; and the
    error of untouched voltages, beside a limit by noise."""
    press_seconds: dict[int, list[float]] = {}
    table_rows = []
    for count in patient(ELECTRODES, "electrodes"):
        channels = channel_table(count)
        press_seconds[count] = _seconds(partial(_press, channels=channels), count, runs)
        name = f"new skin of {count} electrodes, 192 places"
        reference_seconds = press_seconds[ELECTRODES[0]]
        table_rows.append(
            rows.row(
                name, "s", press_seconds[count], f"{ELECTRODES[0]} electrodes", reference_seconds
            )
        )
        for accuracy in ACCURACIES:
            title = f"{count} electrodes, {accuracy}"
            solve_seconds = _seconds(
                partial(_solve, channels=channels, accuracy=accuracy), count, runs
            )
            derivative_seconds = _seconds(partial(_slopes, accuracy=accuracy), count, runs)
            five_solves = [SOLVES * seconds for seconds in solve_seconds]
            table_rows.append(
                rows.row(
                    f"derivatives, {title}", "s", derivative_seconds, "five solves", five_solves
                )
            )
            errors = [_error(skin(count, run), channels, accuracy) for run in range(runs)]
            table_rows.append(
                rows.row(f"error, {title}", "of median |v|", errors, "limit", [ERROR])
            )
    return table_rows


def simultaneous_skins(runs: int) -> list[dict]:
    """Samples of SKINS new skins, each pressed at all places with five forces: in a processor
    second on one core, all skins at once, with NumPy and with PyTorch, beside one by one; on a GPU,
    where there is one, in a second by the clock, beside an aim."""
    import torch  # here, as the other benches' memory is counted without it

    torch.set_num_threads(1)
    channels = channel_table(ELECTRODES[0])
    ways: dict[str, Callable[[list[Geometry]], object]] = {
        "one by one": partial(_press_each, channels=channels),
        "new skins at once, NumPy": partial(_press_all, channels=channels, device=None),
        "new skins at once, PyTorch": partial(_press_all, channels=channels, device="cpu"),
    }
    rates_by_way: dict[str, list[float]] = {name: [] for name in ways}
    for run in patient(range(runs + 1), "together, runs"):
        geometries = [skin(ELECTRODES[0], SKINS * run + k) for k in range(SKINS)]
        for name, way in ways.items():
            start = time.process_time()
            way(geometries)
            rates_by_way[name].append(SAMPLES / (time.process_time() - start))
    (peer, peer_rates), *other_ways = ((name, rates[1:]) for name, rates in rates_by_way.items())
    table_rows = [
        rows.row(name, "samples/s", rates, peer, peer_rates) for name, rates in other_ways
    ]
    if torch.cuda.is_available():
        rates = [_on_gpu(channels, run) for run in range(runs + 1)][1:]
        name = f"new skins at once, {torch.cuda.get_device_name()}"
        table_rows.append(rows.row(name, "samples/s", rates, "mark", [SAMPLES_A_SECOND]))
    return table_rows


def _on_gpu(channels: np.ndarray, run: int) -> float:
    import torch  # as in `simultaneous_skins`

    geometries = [skin(ELECTRODES[0], GPU_SKINS * run + k) for k in range(GPU_SKINS)]
    start = time.perf_counter()
    _press_all(geometries, channels, "cuda")
    torch.cuda.synchronize()
    return SAMPLES / SKINS * GPU_SKINS / (time.perf_counter() - start)


def _press_all(geometries: list[Geometry], channels: np.ndarray, device: str | None) -> None:
    Sheets(geometries, "train", device).channel_change(PLACES_MM, channels, CONTRASTS)


def _press_each(geometries: list[Geometry], channels: np.ndarray) -> None:
    for geometry in geometries:
        _press(geometry, channels)


def _press(geometry: Geometry, channels: np.ndarray) -> None:
    for modes in Forward(geometry, "train").places(PLACES_MM):
        modes.channel_change(channels, CONTRASTS)


def _solve(geometry: Geometry, channels: np.ndarray, accuracy: str) -> None:
    Forward(geometry, accuracy).voltages(channels, TOUCH)


def _slopes(geometry: Geometry, accuracy: str) -> None:
    Forward(geometry, accuracy).derivatives(TOUCH)


def _seconds(work: Callable[[Geometry], None], count: int, runs: int) -> list[float]:
    """Processor seconds of each run, with a new skin each, without a first run that warms up."""
    seconds = []
    for run in range(runs + 1):
        geometry = skin(count, run)
        start = time.process_time()
        work(geometry)
        seconds.append(time.process_time() - start)
    return seconds[1:]


def _error(geometry: Geometry, channels: np.ndarray, accuracy: str) -> float:
    """Root mean square error of untouched voltages, relative to their median size."""
    error = untouched_error(geometry, channels, accuracy)
    size = np.median(np.abs(Forward(geometry, accuracy).voltages(channels)))
    return float(np.sqrt((error**2).mean()) / size)


def drawn_seconds(seed: int, frames: int, names: int) -> float:
    """Seconds of the diagnosis of a drawn recording of KIND, with the catalogue reduced to so many
    names, the true one among them. To be called in a fresh process."""
    other_names = [name for name in effects.catalogue_names() if name != CONCEALED]
    for name in other_names[names - 1 :]:
        del effects.EFFECTS[name]
    return diagnoses.diagnose(KIND, seed, frames, CORES)[0]


def twin_seconds(seed: int, count: int) -> float:
    """Seconds of the diagnosis of `config.yaml`'s twin with so many electrodes and six presses. To
    be called in a fresh process."""
    twin_config = yaml.safe_load((rows.ROOT / "config.yaml").read_text(encoding="utf-8"))["twin"]
    twin_config["skin"]["electrode_deg"] = (360.0 / count * np.arange(count)).tolist()
    twin_config["touch_grid"] |= {"radii": 2, "angles": 3}
    twin_config["press"] |= {"probes_mm": [10.0], "sessions_per_probe": 1}
    with TemporaryDirectory() as folder:
        path = Path(folder) / "twin.parquet"
        twin.write(path, twin.Twin(**twin_config | {"seed": seed}))
        return command_seconds(path)


def command_seconds(path: Path, *options: str) -> float:
    """Seconds of `eitskin diagnose` of a recording, with options, on CORES. To be called in a fresh
    process."""
    os.environ["OMP_NUM_THREADS"] = str(CORES)
    return diagnoses.diagnosis(path, *options)[0]


def grown(runs: int) -> list[dict]:
    """Seconds by the clock of diagnoses of recordings of KIND that have grown by GROWN frames,
    started from the effects before, beside started without. Each run has its own recording."""
    seconds_by_start: dict[bool, list[float]] = {False: [], True: []}
    for run in patient(range(1, runs + 1), "grown, runs"):
        full_recording = cases.draw(KIND, run, diagnoses.FRAMES + GROWN).recorded
        with TemporaryDirectory() as folder:
            path = Path(folder) / "drawn.parquet"
            recording.write(
                subset.stretch(full_recording, 0, diagnoses.FRAMES - 1, str(path)), path
            )
            _in_fresh_process(command_seconds, path)
            effects_file = Path(folder) / "effects.yaml"
            path.with_name("out").joinpath("effects.yaml").replace(effects_file)
            recording.write(full_recording, path)
            for earlier, seconds in seconds_by_start.items():
                options = ["--earlier", str(effects_file)] if earlier else []
                seconds.append(_in_fresh_process(command_seconds, path, *options))
    name = f"diagnosis, {GROWN} frames more, begun with what was found"
    return [rows.row(name, "s", seconds_by_start[True], "begun anew", seconds_by_start[False])]


def _in_fresh_process(work: Callable[..., float], *arguments: object) -> float:
    """The result of a function in a fresh process."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(work, *arguments).result()


def scaled(runs: int) -> list[dict]:
    """Seconds by the clock of diagnoses on two cores, by frames, electrodes and the number of
    names. Each run has its own recordings."""
    name_count = len(effects.catalogue_names())
    names = name_count // 4, name_count // 2, name_count
    groups: tuple[tuple[str, dict[str, tuple]], ...] = (
        (
            f"{diagnoses.FRAMES} frames",
            {f"{n} frames": (drawn_seconds, n, name_count) for n in FRAMES},
        ),
        (
            f"six presses, {ELECTRODES[0]} electrodes",
            {f"six presses, {n} electrodes": (twin_seconds, n) for n in ELECTRODES[:2]},
        ),
        (
            f"{NAMES_FRAMES} frames, {name_count} names",
            {f"{NAMES_FRAMES} frames, {n} names": (drawn_seconds, NAMES_FRAMES, n) for n in names},
        ),
    )
    jobs = {name: job for _, group in groups for name, job in group.items()}
    seconds_by_name: dict[str, list[float]] = {name: [] for name in jobs}
    for run in range(1, runs + 1):
        for name in patient(list(jobs), f"scaled, run {run} of {runs}"):
            work, *arguments = jobs[name]
            seconds_by_name[name].append(_in_fresh_process(work, run, *arguments))
    return [
        rows.row(f"diagnosis, {name}", "s", seconds_by_name[name], peer, seconds_by_name[peer])
        for peer, group in groups
        for name in group
    ]

"""How fast, side by side with peers in one run: `python -m benchmark.speed [NAME ...]`.

Writes benchmarks/NAME.json, a list of rows (`benchmark.rows`), each with the command, the commit,
the machine and the cores used by other work; `benchmark.page` makes a page of them.

`clean`: every side computes the same 208 voltages of a sheet with 16 point electrodes for 192
places and 260 strengths of one circular touch. Slow peers are timed on a few samples, spread evenly
over all. Preparation counts in the time, except for what favours the peers: the mesh, the element
matrices and the touched elements' stiffness are computed before. Before timing, every solver on
pyEIT's mesh must give the same voltages. For the other benches see their functions.
"""

import argparse
import inspect
import json
import math
import os
import resource
import shlex
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from copy import deepcopy
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import yaml
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import SuperLU, splu

from benchmark import costs, diagnoses, plans, rows, sweep
from benchmark.finite_elements import FiniteElements, straight_mesh
from eitskin.atomic import atomic_path
from eitskin.physics.forward import Forward, channel_values
from eitskin.physics.geometry import Geometry
from eitskin.physics.protocol import channel_table
from eitskin.progress import patient
from eitskin.simulate import chain, layout, sets
from eitskin.simulate.stages import Stage

N = 16
CHANNELS = channel_table(N)
MESH_SIZE = 0.05  # of the disc's radius
TOUCH_RADIUS = 0.1  # of the disc's radius: the paper's probe
PLACES = np.array(
    [
        (r * np.cos(angle), r * np.sin(angle))
        for r in np.linspace(0.1, 0.9, 8)
        for angle in 2.0 * np.pi * np.arange(24) / 24
    ]
)
CONTRASTS = 9.0 * np.linspace(0.0, 1.0, 261)[1:]
AGREEMENT = 1e-10  # of the largest voltage, far above rounding
TIMES = {"radii": 5, "angles": 4}  # factors of the grid: 20 times the places
LIMIT_S, LIMIT_MIB = 120.0, 2048.0  # of a set: two minutes, a laptop with 4 GiB
SKINS_A_SECOND = 10.0  # five times the rate before sessions were shared among cores
TRAINED, EPOCHS = 8000, 40  # long enough that weights decay to subnormal numbers

Samples = list[tuple[int, int]]
Solver = Callable[[Samples], np.ndarray]


class MeshSamples:
    """pyEIT's mesh and its touches; a sample is a pair of indices (place, strength)."""

    def __init__(self) -> None:
        # pyeit has no types.
        from pyeit.eit import protocol
        from pyeit.eit.fem import EITForward
        from pyeit.mesh.wrapper import (
            PyEITAnomaly_Circle,
            create,
            set_perm,
        )

        peer = create(N, h0=MESH_SIZE)
        self.pyeit = EITForward(peer, protocol.create(N))
        self.elements = FiniteElements(straight_mesh(peer.node, peer.element), peer.el_pos)
        self.background = np.ones(len(peer.element))
        self.touched: list[np.ndarray] = []
        for place in PLACES:
            circle = PyEITAnomaly_Circle(center=list(place), r=TOUCH_RADIUS, perm=2.0)
            self.touched.append(np.flatnonzero(set_perm(peer, circle, background=1.0).perm == 2.0))

    def conductance(self, place: int, strength: int) -> np.ndarray:
        """Conductance (elements,) in S of one sample."""
        conductance = self.background.copy()
        conductance[self.touched[place]] *= 1.0 + CONTRASTS[strength]
        return conductance

    def by_pyeit(self, samples: Samples) -> np.ndarray:
        """pyEIT's solve_eit, one sample at a time; its measurement is u[minus] - u[plus]."""
        return -np.array([self.pyeit.solve_eit(self.conductance(*s)) for s in samples])

    def by_factoring(self, samples: Samples) -> np.ndarray:
        """SciPy: one sparse factorisation for each sample, with which all electrodes are solved."""
        return np.array(
            [
                channel_values(
                    self.elements.transfer_impedance(self.conductance(*sample)), CHANNELS
                )
                for sample in samples
            ]
        )

    def by_touch_modes(self, _: Samples) -> np.ndarray:
        """Closed form in the strength on the same mesh: all samples (C, M)."""
        factored = self.elements.factored(self.background)
        untouched = channel_values(factored.transfer_impedance, CHANNELS)
        values = np.empty((len(PLACES), len(CONTRASTS), len(CHANNELS)))
        for place, touched in enumerate(self.touched):
            modes = factored.touch_modes(touched)
            values[place] = untouched + modes.channel_change(CHANNELS, CONTRASTS)
        return values.reshape(-1, len(CHANNELS))


class Woodbury:
    """SciPy: the untouched sheet factored once, each sample corrected by a small dense solve.

    With `caches_places`, quantities of the place alone are computed once for each place, not for
    each sample. The factorisation counts in the time.
    """

    def __init__(self, sheet: MeshSamples, caches_places: bool):
        self.sheet, self.caches_places = sheet, caches_places
        self.changes = [self._change(touched) for touched in sheet.touched]

    def _change(self, touched: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        elements = self.sheet.elements
        dofs = elements.basis.element_dofs[:, touched]
        nodes = np.unique(dofs)
        local = np.zeros(len(self.sheet.background))
        local[touched] = 1.0
        stiffness = elements.stiffness(self.sheet.background + local)
        stiffness = stiffness - elements.stiffness(self.sheet.background)
        return nodes, stiffness[nodes][:, nodes].toarray()

    def __call__(self, samples: Samples) -> np.ndarray:
        elements = self.sheet.elements
        matrix = elements.stiffness(self.sheet.background)
        size = matrix.shape[0]
        ground = self.sheet.pyeit.mesh.ref_node
        terminals = self.sheet.pyeit.mesh.el_pos
        free = np.delete(np.arange(size), ground)
        factors = splu(
            csc_matrix(matrix[free][:, free]),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
        currents = np.zeros((size, N))
        currents[terminals, np.arange(N)] = 1.0
        fields = np.zeros((size, N))
        fields[free] = factors.solve(currents[free])
        untouched = fields[terminals]
        place_columns: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        values = np.empty((len(samples), len(CHANNELS)))
        for row, (place, strength) in enumerate(samples):
            nodes, change = self.changes[place]
            if not self.caches_places or place not in place_columns:
                place_columns[place] = self._columns(factors, free, nodes, change)
            stiffness_change, response = place_columns[place]
            system = np.eye(len(nodes)) / CONTRASTS[strength] + response
            correction = fields[nodes].T @ np.linalg.solve(system, stiffness_change @ fields[nodes])
            values[row] = channel_values(untouched - correction, CHANNELS)
        return values

    @staticmethod
    def _columns(
        factors: SuperLU, free: np.ndarray, nodes: np.ndarray, change: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        unit = np.zeros((len(free) + 1, len(nodes)))
        unit[nodes, np.arange(len(nodes))] = 1.0
        potentials = np.zeros_like(unit)
        potentials[free] = factors.solve(unit[free])
        return change, change @ potentials[nodes]


def by_forward_model(_: Samples) -> np.ndarray:
    """eitskin's forward model at `train` accuracy: all samples (C, M)."""
    radius_mm, points = 80.0, np.zeros(N)
    forward = Forward(
        Geometry(radius_mm, 1.0, 1000.0, 360.0 * np.arange(N) / N, points, points), "train"
    )
    untouched = channel_values(forward.transfer_impedance(), CHANNELS)
    values = np.empty((len(PLACES), len(CONTRASTS), len(CHANNELS)))
    for place, (x, y) in enumerate(radius_mm * PLACES):
        modes = forward.place(x, y, TOUCH_RADIUS * radius_mm)
        values[place] = untouched + modes.channel_change(CHANNELS, CONTRASTS)
    return values.reshape(-1, len(CHANNELS))


def spread_samples(count: int) -> Samples:
    """`count` samples, place-major, spread evenly over places and strengths."""
    flat = np.linspace(0, len(PLACES) * len(CONTRASTS) - 1, count).round().astype(int)
    return [(int(i) // len(CONTRASTS), int(i) % len(CONTRASTS)) for i in flat]


def rates(solver: Solver, samples: Samples, runs: int) -> list[float]:
    """Samples in a processor second, for each run, without a first run that warms up."""
    solver(samples)
    sample_rates = []
    for _ in range(runs):
        start = time.process_time()
        sample_rates.append(len(solver(samples)) / (time.process_time() - start))
    return sample_rates


def disagreement(sheet: MeshSamples, solvers: list[Solver]) -> float:
    """Largest difference from pyEIT's voltages on its mesh, of the largest voltage, 24 samples."""
    samples = spread_samples(24)
    expected = sheet.by_pyeit(samples)
    rows = [place * len(CONTRASTS) + strength for place, strength in samples]
    mode_values = sheet.by_touch_modes(samples)[rows]
    solver_values = [mode_values, *(solver(samples) for solver in solvers)]
    return max(np.max(abs(values - expected)) for values in solver_values) / np.max(abs(expected))


def clean(runs: int) -> list[dict]:
    """Clean samples in a processor second: our forward model, and our closed form on pyEIT's mesh,
    beside each peer.

    Raises RuntimeError where the solvers on pyEIT's mesh disagree.
    """
    sheet = MeshSamples()
    per_sample = Woodbury(sheet, caches_places=False)
    per_place = Woodbury(sheet, caches_places=True)
    difference = disagreement(sheet, [sheet.by_factoring, per_sample, per_place])
    if not difference < AGREEMENT:
        raise RuntimeError(f"solvers on pyEIT's mesh differ by {difference:.1e} of a voltage")
    ours: dict[str, Solver] = {
        "clean": by_forward_model,
        "clean on pyEIT's mesh": sheet.by_touch_modes,
    }
    peers: dict[str, tuple[Solver, Samples]] = {
        "pyEIT 1.2.4": (sheet.by_pyeit, spread_samples(12)),
        "SciPy, one factorisation a sample": (sheet.by_factoring, spread_samples(96)),
        "SciPy, one factorisation in all, Woodbury a sample": (per_sample, spread_samples(384)),
        "SciPy, the same, columns kept for each place": (
            per_place,
            spread_samples(len(PLACES) * len(CONTRASTS)),
        ),
    }
    solvers = {**{name: (solver, Samples()) for name, solver in ours.items()}, **peers}
    measured = {
        name: rates(*solvers[name], runs) for name in patient(list(solvers), "clean, solvers")
    }
    return [
        rows.row(name, "samples/s", measured[name], peer, measured[peer])
        for name in ours
        for peer in peers
    ]


def perturb(config: dict, name: str) -> tuple[int, float, float]:
    """Simulate configuration `name` up to its dataset, as in the workflow.

    Returns samples, processor seconds and the process's peak memory in MiB; to be called in a fresh
    process.
    """
    start = time.process_time()
    configuration = config["configurations"][name]
    with TemporaryDirectory() as folder:
        stage = _skin_stage(config, name, Path(folder))
        effects = chain.instrument_effects(configuration["effects"])
        for position, effect in enumerate(effects.values(), start=1):
            next_stage = stage.with_name(str(position))
            sets.write_stage(stage, next_stage, config["seed"], effect, position)
            stage = next_stage
        dataset = Path(folder) / "dataset.parquet"
        noise, baseline = configuration["noise"], configuration["baseline"]
        sets.write_dataset(stage, dataset, name, config["seed"], noise, baseline)
        samples = sum(len(part.table) for part in Stage(stage))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    return samples, time.process_time() - start, peak


def _skin_stage(config: dict, name: str, folder: Path) -> Path:
    """The stage file of configuration `name` with every session's skin pressed."""
    configuration = config["configurations"][name]
    mesh, places, stage = (folder / part for part in ("mesh.npz", "places.csv", "0"))
    blocks = ("seed", "skin", "protocol", "touch_grid", "forces", "accuracy")
    layout.write(mesh, places, layout.Layout(**{block: config[block] for block in blocks}))
    skin_stage = sets.SkinStage(
        config["seed"],
        config["skin"],
        config["accuracy"],
        chain.skin_effects(configuration["effects"]),
        configuration["session_frames"],
        configuration["crossed"],
    )
    sets.write_skin_stage(mesh, places, stage, skin_stage)
    return stage


def skins_a_second(config: dict, threads: int) -> float:
    """Skins solved and pressed at all places in a second by the clock, on so many cores."""
    os.environ["OMP_NUM_THREADS"] = str(threads)
    with TemporaryDirectory() as folder:
        start = time.perf_counter()
        stage = _skin_stage(config, "crossed", Path(folder))
        seconds = time.perf_counter() - start
        count = sum(part.table["session"].nunique() for part in Stage(stage))
    return count / seconds


def skins(runs: int) -> list[dict]:
    """New skins in a second by the clock, each pressed at all places: on two cores, beside one core
    and beside a mark."""
    config = yaml.safe_load(Path("config.yaml").read_text(encoding="utf-8"))
    rates_by_threads: dict[int, list[float]] = {1: [], 2: []}
    for _ in patient(range(runs), "skins, runs"):
        for threads, rates in rates_by_threads.items():
            with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
                rates.append(pool.submit(skins_a_second, config, threads).result())
    peers = {"one core": rates_by_threads[1], "mark": [SKINS_A_SECOND]}
    return [
        rows.row("skins", "skins/s", rates_by_threads[2], name, peer)
        for name, peer in peers.items()
    ]


def perturbed(runs: int) -> list[dict]:
    """Processor seconds and peak memory of the perturbed sets of config.yaml, beside limits.

    A fresh process on one core for each run; a new geometry every `session_frames` samples. The set
    of the authors also once with TIMES the samples: its memory beside that of one set.
    """
    config = yaml.safe_load(Path("config.yaml").read_text(encoding="utf-8"))
    larger = deepcopy(config)
    for key, factor in TIMES.items():
        larger["touch_grid"][key] *= factor
    table_rows: list[dict] = []
    sizes: dict[str, tuple] = {}
    for name in patient(["larger", "authors", "crossed"], "perturbed, sets"):
        measurements = []
        for _ in range(1 if name == "larger" else runs):
            job = (larger, "authors") if name == "larger" else (config, name)
            with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
                measurements.append(pool.submit(perturb, *job).result())
        samples, seconds, peaks = zip(*measurements, strict=True)
        sizes[name] = samples[0], peaks
        if name == "larger":
            continue
        label = "perturbed" if name == "authors" else f"perturbed, {name}"
        title = f"limit for {samples[0]} samples"
        table_rows.append(rows.row(label, "s", seconds, title, [LIMIT_S]))
        table_rows.append(rows.row(f"{label}, memory", "MiB", peaks, title, [LIMIT_MIB]))
    (large_samples, peak), (samples_of_one, peak_of_one) = sizes["larger"], sizes["authors"]
    label = f"perturbed, memory of {large_samples} samples"
    table_rows.append(rows.row(label, "MiB", peak, f"of {samples_of_one} samples", peak_of_one))
    return table_rows


def trained(runs: int) -> list[dict]:
    """Samples in a processor second of the training loop, for a perceptron of 512, 256, 128 and
    TRAINED samples with partly random labels, so that weights decay: as it is, and with subnormal
    numbers. The last of EPOCHS epochs counts."""
    import torch  # here, as the other benches' memory is counted without it

    from eitskin.learn import train
    from eitskin.learn.networks.mlp import Mlp

    train.deterministic()
    generator = torch.Generator().manual_seed(1)
    voltage = torch.randn(TRAINED, len(CHANNELS), generator=generator)
    state = voltage[:, :3] + torch.randn(TRAINED, 3, generator=generator)
    samples, adam = (voltage, state), train.Optimiser(weight_decay=1e-3)

    def loss(module: torch.nn.Module, v: torch.Tensor, s: torch.Tensor) -> torch.Tensor:
        step_times.append(time.process_time())
        return (module(v) - s).square().mean()

    step_times: list[float] = []
    steps = math.ceil(TRAINED / adam.batch_size)

    def rate(loop: Callable) -> float:
        step_times.clear()
        torch.manual_seed(1)
        module = Mlp(len(CHANNELS), 3, (512, 256, 128))
        parts = samples, (voltage[:1], state[:1])
        loop(module, parts, loss, adam, train.Budget(None, EPOCHS), 1)
        # The last time is the validation's.
        return (steps - 1) * adam.batch_size / (step_times[-2] - step_times[-1 - steps])

    loops = train.fit, inspect.unwrap(train.fit)
    rate_pairs = [[rate(loop) for loop in loops] for _ in patient(range(runs), "trained, runs")]
    ours, peer = zip(*rate_pairs, strict=True)
    return [rows.row("trained", "samples/s", ours, "subnormal numbers kept", peer)]


def streamed(runs: int) -> list[dict]:
    """Milliseconds from a frame to its verdict, by every model of Table I: `benchmark.latency`."""
    from benchmark import latency  # here, as it brings torch

    return latency.streamed(runs)


BENCHES = {
    "clean": clean,
    "skins": skins,
    "electrodes": costs.electrodes,
    "together": costs.simultaneous_skins,
    "perturbed": perturbed,
    "trained": trained,
    "diagnosed": diagnoses.diagnosed,
    "scaled": costs.scaled,
    "grown": costs.grown,
    "swept": sweep.swept,
    "planned": plans.planned,
    "streamed": streamed,
}


def main(arguments: list[str] | None = None) -> None:
    """Run the named benches, by default all, print their ratios and write them."""
    parser = argparse.ArgumentParser(prog="python -m benchmark.speed", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"{', '.join(BENCHES)}: all")
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--output", type=Path, default=rows.ROOT / "benchmarks")
    options = parser.parse_args(arguments)
    if unknown := set(options.names) - set(BENCHES):
        parser.error(f"no bench: {', '.join(sorted(unknown))}")
    command_arguments = sys.argv[1:] if arguments is None else arguments
    threads = os.environ.get("OMP_NUM_THREADS")
    cores = "-u OMP_NUM_THREADS" if threads is None else f"OMP_NUM_THREADS={threads}"
    command = shlex.join(["python", "-m", "benchmark.speed", *command_arguments])
    provenance = {
        "command": f"env {cores} {command}",
        "commit": rows.commit(),
        "machine": rows.machine(),
    }
    for name in options.names or BENCHES:
        other_work = rows.OtherWork()
        bench_rows = BENCHES[name](options.runs)
        columns = provenance | {"others_cores": other_work.cores()}
        with atomic_path(options.output / f"{name}.json") as path:
            path.write_text(
                json.dumps([line | columns for line in bench_rows], indent=2) + "\n",
                encoding="utf-8",
            )
        for line in bench_rows:
            print(
                f"{line['name']}: {line['ours']:.4g} {line['unit']}; {line['peer_name']}: "
                f"{line['peer']:.4g}; ratio {line['ratio']:.4g} (of {line['runs']} runs)"
            )


if __name__ == "__main__":
    main()

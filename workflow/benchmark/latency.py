"""The time from a frame to its verdict: `python -m benchmark.speed streamed`."""

import time
from collections.abc import Callable, Iterator
from functools import partial
from io import StringIO

import numpy as np
import pandas as pd
import torch

from benchmark.rows import row
from eitskin.data import splits
from eitskin.data.baseline import untouched_noise
from eitskin.data.dataset import Dataset
from eitskin.exported.predictor import Predictor
from eitskin.learn import export, models, train
from eitskin.physics.protocol import channel_table
from eitskin.progress import patient
from eitskin.stream.frames import Frame
from eitskin.stream.judge import Judge
from eitskin.stream.run import Tally, run
from eitskin.stream.sources import Source
from eitskin.stream.view import View

CHANNELS = channel_table(16)
TOUCHES, FRAMES, WARM = 2500, 1000, 50  # to train on, to time, and before these to warm up
NOISE = 0.02  # of a change
LEVEL_V = 10.0  # of the untouched skin
LIMIT_MS = 1.0  # a twentieth of a frame's time
LATENT = 16  # of the autoencoder, as in `config.yaml`
LOST = 5  # electrode


def drawn(states: np.ndarray, draw: np.random.Generator) -> np.ndarray:
    """(N, M): noisy changes of a smooth random skin at states (N, 3). Only their number matters to
    the time."""
    skin = np.random.default_rng(1)
    waves = skin.normal(0.0, 0.03, (2, len(CHANNELS)))
    phases = skin.uniform(0.0, 2.0 * np.pi, len(CHANNELS))
    change = 0.1 * states[:, 2:] * np.cos(states[:, :2] @ waves + phases)
    return change + NOISE * draw.standard_normal(change.shape)


def touched(count: int, draw: np.random.Generator) -> np.ndarray:
    """(N, 3): random states, in mm, mm, N."""
    places = draw.uniform(-50.0, 50.0, (count, 2))
    return np.column_stack([places, draw.uniform(2.0, 10.0, count)])


def training_set() -> Dataset:
    """The touches on which every model is trained briefly; its errors do not matter here."""
    draw = np.random.default_rng(2)
    states = touched(TOUCHES, draw)
    numbers = {name: np.arange(TOUCHES) for name in ("sample", "session", "place")}
    columns = dict(zip(("x_mm", "y_mm", "force_N"), states.T, strict=True))
    table = pd.DataFrame({**numbers, **columns, "probe_mm": 10.0, "depth_mm": np.nan})
    metadata = {
        "format": "eitskin-dataset",
        "version": 1,
        "name": "drawn",
        "origin": "simulated",
        "configuration": "",
        "targets": ["x", "y", "F"],
        "unit": "V",
        "voltage": "signed",
        "channels": CHANNELS.tolist(),
        "untouched": untouched_noise(drawn(0.0 * states, draw)),
    }
    return Dataset(table, drawn(states, draw).astype(np.float32), metadata)


def milliseconds(
    function: Callable, inputs: np.ndarray, clock: Callable[[], float] = time.perf_counter
) -> np.ndarray:
    """(n,): the time of a call with each of the inputs (n, ...), after WARM uncounted ones."""
    for frame in inputs[:WARM]:
        function(frame)
    times = []
    for frame in inputs:
        start = clock()
        function(frame)
        times.append(clock() - start)
    return 1e3 * np.array(times)


def processor_milliseconds(function: Callable, inputs: np.ndarray) -> np.ndarray:
    """`milliseconds` of this thread's processor time, without that of other work on the machine."""
    return milliseconds(function, inputs, time.thread_time)


def loop(judge: Judge, inputs: np.ndarray) -> np.ndarray:
    """(n,): as `milliseconds`, for the whole loop with its line of JSON."""
    ends_s: list[float] = []

    def frames() -> Iterator[Frame]:
        for number, reading in enumerate(inputs):
            ends_s.append(time.perf_counter())
            yield Frame(0.05 * number, ends_s[-1], reading)
        ends_s.append(time.perf_counter())

    view = View(judge.predictor.targets, True, StringIO())
    run(Source(frames(), 1, False, "drawn"), judge, view, None, Tally())
    return 1e3 * np.diff(ends_s)[WARM:]


def streamed(runs: int) -> list[dict]:
    """Rows of each model of Table I on one core: the time from a reading to its verdict, median and
    99 % over FRAMES touches beside LIMIT_MS, median over `runs`, by the clock and in processor
    time; that of the state alone beside PyTorch; for the MLP also without an electrode, and of the
    whole loop."""
    train.deterministic()
    data, draw = training_set(), np.random.default_rng(3)
    part = splits.assign(data.table, "random", 1)
    optimiser, budget = train.Optimiser(2e-3), train.Budget(None, 1)
    recipe = train.Recipe(optimiser, budget, widths=(512, 256, 128), latent_dim=LATENT)
    touched_readings = LEVEL_V + drawn(touched(FRAMES, draw), draw)
    untouched_readings = LEVEL_V + drawn(np.zeros((10, 3)), draw)
    rows = []

    def add_rows(
        name: str, judge: Callable[[], Callable], measure: Callable = milliseconds
    ) -> None:
        quantiles = []
        for _ in range(runs):
            verdict = judge() if measure is loop else partial(judge(), time_s=0.0)
            quantiles.append(np.quantile(measure(verdict, touched_readings), [0.5, 0.99]))
        for words, values in zip(("median", "99 %"), np.transpose(quantiles), strict=True):
            label = f"streamed, {name}, {words}"
            rows.append(row(label, "ms", values.tolist(), "limit", [LIMIT_MS]))

    def judge_of(predictor: Predictor, lost: bool = False) -> Callable[[], Judge]:
        def build() -> Judge:
            judge = Judge(predictor)
            for reading in untouched_readings:
                judge(reading, 0.0)
            if lost:
                judge.set_lost_electrodes([LOST])
            return judge

        return build

    for name in patient(list(models.MODELS), "streamed, models"):
        model = train.train_model(train.Split(data, part), name, recipe, 1)
        predictor = Predictor(export.export(model, data, part, None, 1))
        add_rows(name, judge_of(predictor))
        add_rows(f"{name}, processor time", judge_of(predictor), processor_milliseconds)
        states = export.States(model).eval()

        def by_torch(change: np.ndarray, states: export.States = states) -> torch.Tensor:
            return states(torch.from_numpy(change[None]))

        sides = (
            (lambda change, numpy_predictor=predictor: numpy_predictor.states(change[None])),
            by_torch,
        )
        numpy_ms, torch_ms = (
            [float(np.median(milliseconds(side, touched_readings - LEVEL_V))) for _ in range(runs)]
            for side in sides
        )
        rows.append(row(f"state alone, {name}", "ms", numpy_ms, "PyTorch", torch_ms))
        if name == "mlp":
            add_rows("mlp without an electrode", judge_of(predictor, lost=True))
            add_rows("mlp, whole loop", judge_of(predictor), loop)
    return rows

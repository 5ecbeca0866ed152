"""How long a frame waits for its verdict: `python -m benchmark.speed streamed`."""

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
from eitskin.stream.run import Told, run
from eitskin.stream.sources import Source
from eitskin.stream.view import View

CHANNELS = channel_table(16)
TOUCHES, FRAMES, WARM = 2500, 1000, 50
NOISE = 0.02  # of a change
LEVEL_V = 10.0  # of the untouched skin
LIMIT_MS = 1.0
LATENT = 16
LOST = 5  # electrode


def drawn(states: np.ndarray, draw: np.random.Generator) -> np.ndarray:
    """(N, M): changes of a smooth random skin at states (N, 3), with noise. Only their number of
    channels counts here."""
    skin = np.random.default_rng(1)
    waves = skin.normal(0.0, 0.03, (2, len(CHANNELS)))
    phases = skin.uniform(0.0, 2.0 * np.pi, len(CHANNELS))
    change = 0.1 * states[:, 2:] * np.cos(states[:, :2] @ waves + phases)
    return change + NOISE * draw.standard_normal(change.shape)


def touched(count: int, draw: np.random.Generator) -> np.ndarray:
    """(N, 3): states, mm, mm, N."""
    places = draw.uniform(-50.0, 50.0, (count, 2))
    return np.column_stack([places, draw.uniform(2.0, 10.0, count)])


def learned_from() -> Dataset:
    """The touches that every model is trained on, briefly: what they are worth does not count."""
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
    function: Callable, given: np.ndarray, clock: Callable[[], float] = time.perf_counter
) -> np.ndarray:
    """(n,): the time of each call, one of `given` (n, ...) after the other, some before them
    uncounted."""
    for one in given[:WARM]:
        function(one)
    times = []
    for one in given:
        start = clock()
        function(one)
        times.append(clock() - start)
    return 1e3 * np.array(times)


def of_processor(function: Callable, given: np.ndarray) -> np.ndarray:
    """As `milliseconds`, of this thread's processor time: what others on the machine take is not
    in it."""
    return milliseconds(function, given, time.thread_time)


def loop(judge: Judge, given: np.ndarray) -> np.ndarray:
    """(n,): as `milliseconds`, of the whole loop, a line of JSON included."""
    ended: list[float] = []

    def frames() -> Iterator[Frame]:
        for number, one in enumerate(given):
            ended.append(time.perf_counter())
            yield Frame(0.05 * number, ended[-1], one)
        ended.append(time.perf_counter())

    view = View(judge.predictor.targets, True, StringIO())
    run(Source(frames(), 1, False, "drawn"), judge, view, None, Told())
    return 1e3 * np.diff(ended)[WARM:]


def streamed(runs: int) -> list[dict]:
    """Rows of each model of Table I, on one core: from a reading to its verdict, median and 99 % of
    FRAMES touches beside LIMIT_MS, the median over `runs`, by the clock and in processor time; the
    state alone beside PyTorch; of the MLP also without an electrode, and the whole loop."""
    train.deterministic()
    data, draw = learned_from(), np.random.default_rng(3)
    part = splits.assign(data.table, "random", 1)
    optimiser, budget = train.Optimiser(2e-3), train.Budget(None, 1)
    recipe = train.Recipe(optimiser, budget, widths=(512, 256, 128), latent_dim=LATENT)
    given = LEVEL_V + drawn(touched(FRAMES, draw), draw)
    still = LEVEL_V + drawn(np.zeros((10, 3)), draw)
    rows = []

    def told(name: str, judge: Callable[[], Callable], measure: Callable = milliseconds) -> None:
        found = []
        for _ in range(runs):
            own = judge() if measure is loop else partial(judge(), time_s=0.0)
            found.append(np.quantile(measure(own, given), [0.5, 0.99]))
        for words, values in zip(("median", "99 %"), np.transpose(found), strict=True):
            label = f"streamed, {name}, {words}"
            rows.append(row(label, "ms", values.tolist(), "limit", [LIMIT_MS]))

    def judge_of(predictor: Predictor, lost: bool = False) -> Callable[[], Judge]:
        def made() -> Judge:
            judge = Judge(predictor)
            for one in still:
                judge(one, 0.0)
            if lost:
                judge.lose([LOST])
            return judge

        return made

    for name in patient(list(models.MODELS), "streamed, models"):
        model = train.train_model(train.Split(data, part), name, recipe, 1)
        predictor = Predictor(export.export(model, data, part, None, 1))
        told(name, judge_of(predictor))
        told(f"{name}, processor time", judge_of(predictor), of_processor)
        states = export.States(model).eval()

        def by_torch(one: np.ndarray, states: export.States = states) -> torch.Tensor:
            return states(torch.from_numpy(one[None]))

        sides = (lambda one, own=predictor: own.states(one[None])), by_torch
        ours, peer = (
            [float(np.median(milliseconds(side, given - LEVEL_V))) for _ in range(runs)]
            for side in sides
        )
        rows.append(row(f"state alone, {name}", "ms", ours, "PyTorch", peer))
        if name == "mlp":
            told("mlp without an electrode", judge_of(predictor, lost=True))
            told("mlp, whole loop", judge_of(predictor), loop)
    return rows

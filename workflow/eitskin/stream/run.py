"""The loop: frame, verdict, and only then whatever is shown or kept of it."""

import gc
import time
from collections import Counter, deque
from dataclasses import dataclass, field

import numpy as np

from eitskin.stream.frames import Trouble
from eitskin.stream.judge import Judge
from eitskin.stream.kept import Keeper
from eitskin.stream.sources import Source
from eitskin.stream.view import View

KEPT = 100_000  # latencies


@dataclass
class Told:
    """How many frames had which verdict, how many lines were no frames, and seconds (n,) from a
    frame's end to its verdict, of the latest KEPT."""

    kinds: Counter = field(default_factory=Counter)
    troubles: int = 0
    latency_s: deque[float] = field(default_factory=lambda: deque(maxlen=KEPT))

    def sentence(self) -> str:
        """All of it in a line."""
        kinds = ", ".join(f"{count} {kind}" for kind, count in self.kinds.items()) or "none"
        words = f"frames: {kinds}; {self.troubles} times something else"
        if self.latency_s:
            half, most = 1e3 * np.quantile(self.latency_s, [0.5, 0.99])
            words += f"; from frame to verdict {half:.2f} ms, 99 % within {most:.2f} ms"
        return words


def run(source: Source, judge: Judge, view: View, keeper: Keeper | None, told: Told) -> None:
    """Judge all frames of a source; `told` is filled as they come."""
    gc.collect()
    gc.freeze()  # what is there stays: no frame waits for it to be searched
    for event in source.events:
        if isinstance(event, Trouble):
            told.troubles += 1
            view.trouble(event)
            continue
        verdict = judge(event.reading, event.time_s, event.saturated)
        told.latency_s.append(time.perf_counter() - event.ready_s)
        told.kinds[verdict.kind] += 1
        view.frame(event, verdict)
        if keeper is not None:
            keeper(event, verdict)

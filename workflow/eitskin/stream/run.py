"""The loop of a stream: each frame is judged before it is shown and recorded."""

import gc
import time
from collections import Counter, deque
from dataclasses import dataclass, field

import numpy as np

from eitskin.stream.frames import Trouble
from eitskin.stream.judge import Judge
from eitskin.stream.page import PageView
from eitskin.stream.recorder import Recorder
from eitskin.stream.sources import Source
from eitskin.stream.view import View

MAX_LATENCIES = 100_000  # 1 MB; a stream may run for days


@dataclass
class Tally:
    """Counts of verdicts and troubles, and the latest MAX_LATENCIES latencies.

    `latency_s` is the time from a frame's end to its verdict in seconds.
    """

    verdict_counts: Counter = field(default_factory=Counter)
    n_troubles: int = 0
    latency_s: deque[float] = field(default_factory=lambda: deque(maxlen=MAX_LATENCIES))

    def sentence(self) -> str:
        """The tally in one line."""
        counts = (
            ", ".join(f"{count} {kind}" for kind, count in self.verdict_counts.items()) or "none"
        )
        text = f"frames: {counts}; {self.n_troubles} times something else"
        if self.latency_s:
            median_ms, percentile_99_ms = 1e3 * np.quantile(self.latency_s, [0.5, 0.99])
            text += (
                f"; from frame to verdict {median_ms:.2f} ms, 99 % within {percentile_99_ms:.2f} ms"
            )
        return text


def run(
    source: Source, judge: Judge, view: View | PageView, recorder: Recorder | None, tally: Tally
) -> None:
    """Judge all frames of a source; `tally` is updated with each."""
    gc.collect()
    gc.freeze()  # no frame waits for a collection that searches the model
    for event in source.events:
        if isinstance(event, Trouble):
            tally.n_troubles += 1
            view.trouble(event)
            continue
        verdict = judge(event.reading, event.time_s, event.saturated)
        tally.latency_s.append(time.perf_counter() - event.ready_s)
        tally.verdict_counts[verdict.kind] += 1
        view.frame(event, verdict)
        if recorder is not None:
            recorder(event, verdict)

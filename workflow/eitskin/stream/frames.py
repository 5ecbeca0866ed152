"""What comes from a source: frames, and what stands in their place."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Frame:
    """reading (M,) in the model's unit, of its channels; time_s from the first one on; ready_s:
    when it was whole, by `time.perf_counter`; saturated (M,) bool."""

    time_s: float
    ready_s: float
    reading: np.ndarray
    saturated: np.ndarray | None = None


@dataclass(frozen=True)
class Trouble:
    """What came in place of a frame."""

    time_s: float
    words: str


Event = Frame | Trouble

"""The events of a source: frames, and troubles in their place."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Frame:
    """One frame: `reading` (M,) of the model's channels in its unit.

    `time_s` is counted from the first frame; `ready_s` is when the frame was complete, by
    `time.perf_counter`; `saturated` (M,) bool marks readings at the converter's limit.
    """

    time_s: float
    ready_s: float
    reading: np.ndarray
    saturated: np.ndarray | None = None


@dataclass(frozen=True)
class Trouble:
    """A message about what came in place of a frame."""

    time_s: float
    message: str


Event = Frame | Trouble

"""What an effect is: physics written once, for the simulator to apply and the diagnosis to fit."""

from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from eitskin.geometry import Geometry

STAGES = ("touch", "skin", "wiring", "instrument", "clock")
INSTRUMENT_ORDER = ("common mode", "gain", "mixing", "offset", "mains", "converter")


@dataclass(frozen=True)
class Parameter:
    """One parameter: its unit, the value at which the effect does nothing, and its bounds.

    neutral None: there is no such value and one must be given, unless `optional`. dense: one value
    a site rather than one for all. scale: the size of a typical change, the prior's sd.
    """

    unit: str
    neutral: float | None
    low: float
    high: float
    scale: float = 1.0
    dense: bool = True
    optional: bool = False


class Effect:
    """One effect: class attributes say what it is, one method for its stage says what it does.

    name: the field's term; stage: where it enters, one of STAGES in this order; driver: what it
    varies with; sites: the kind of place it may be confined to, or None; parameters by name;
    source: who described it; mend: what to do at the bench; confusable: names that look alike.
    """

    name: str
    stage: str
    driver: str
    sites: str | None
    parameters: dict[str, Parameter]
    source: str
    mend: str
    confusable: tuple[str, ...] = ()


@dataclass(frozen=True)
class Setting:
    """An effect at definite values: `sites` (S,) indices or None, `values` a number or (S,)
    each."""

    effect: Effect
    sites: np.ndarray | None
    values: dict[str, np.ndarray | float | None] = field(default_factory=dict)


@dataclass(frozen=True)
class Frames:
    """N frames of M channels as an effect meets them.

    time_s, force_N (N,), force as reported, 0 where untouched; press (N,) int, -1 where untouched;
    channels (M, 4); frame_s: how long a frame takes, or None; force_max_N: half of it is F_mid;
    sink_grounded: whether the current source's sink is tied to ground; above_sink_V (N, M): mean
    potential of the measuring pair above the sink, once the skin is solved.
    """

    time_s: np.ndarray
    force_N: np.ndarray
    press: np.ndarray
    channels: np.ndarray
    frame_s: float | None = None
    force_max_N: float = 0.0
    sink_grounded: bool = False
    above_sink_V: np.ndarray | None = None

    def reading_time_s(self) -> np.ndarray:
        """(N, M) s: when each channel is read, evenly within its frame (0 long where unknown)."""
        share = np.arange(len(self.channels)) / len(self.channels)
        return self.time_s[:, None] + share * (self.frame_s or 0.0)


@dataclass(frozen=True)
class Moment:
    """When and how a skin is touched: minutes from the start, N, mm (NaN where untouched)."""

    minutes: float
    force_N: float
    x_mm: float
    y_mm: float


START = Moment(0.0, 0.0, float("nan"), float("nan"))


class TouchEffect(Effect):
    """An effect on what a touch is before the skin feels it; `on_force`: on the force itself."""

    stage = "touch"
    on_force = False

    def change(self, touches: pd.DataFrame, setting: Setting, frames: Frames) -> pd.DataFrame:
        """`touches`, one row a frame: x_mm, y_mm, radius_mm, contrast, force_N; changed."""
        raise NotImplementedError


class SkinEffect(Effect):
    """An effect on the skin: its shape, its material, its electrodes."""

    stage = "skin"

    def change(self, geometry: Geometry, setting: Setting, moment: Moment) -> Geometry:
        """The geometry at a moment, changed."""
        raise NotImplementedError


class WiringEffect(Effect):
    """An effect between the electrodes and the board: leaks, broken and exchanged wires."""

    stage = "wiring"

    def change(
        self,
        potential: np.ndarray,
        setting: Setting,
        drives: np.ndarray,
        transfer: np.ndarray,
        frames: Frames,
    ) -> np.ndarray:
        """Potentials (N, D, n) V per A at the board, for drives (D, 2) of the skin `transfer`
        (N, n, n) ohm; changed."""
        raise NotImplementedError


class ClockEffect(Effect):
    """An effect on when each channel sees the state."""

    stage = "clock"

    def force_shift(self, setting: Setting, frames: Frames) -> np.ndarray:
        """(N,) N: force at the frame's last channel minus that at its first."""
        raise NotImplementedError


class InstrumentEffect(Effect):
    """An effect on readings; `order` is its place in the chain, one of INSTRUMENT_ORDER."""

    stage = "instrument"
    order: str

    def change(self, voltage: np.ndarray, setting: Setting, frames: Frames) -> np.ndarray:
        """Readings (N, M) V of `voltage` (N, M) V."""
        raise NotImplementedError

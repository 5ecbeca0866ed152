"""What an effect is: physics written once, for the simulator to apply and the diagnosis to fit."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from eitskin.geometry import Geometry

STAGES = ("touch", "skin", "instrument")


@dataclass(frozen=True)
class Parameter:
    """One parameter: its unit, the value at which the effect does nothing, and its bounds.

    neutral None: there is no such value and one must be given, unless `optional`. dense: one value
    a site rather than one for all.
    """

    unit: str
    neutral: float | None
    low: float
    high: float
    dense: bool = True
    optional: bool = False


class Effect:
    """One effect: class attributes say what it is, one method for its stage says what it does.

    name: the field's term; stage: where it enters, in the order touch, skin, instrument; driver:
    what it varies with; sites: the kind of place it may be confined to, or None; parameters by
    name.
    """

    name: str
    stage: str
    driver: str
    sites: str | None
    parameters: dict[str, Parameter]
    source: str


@dataclass(frozen=True)
class Setting:
    """An effect at definite values: `sites` (S,) indices or None, `values` a number or (S,)
    each."""

    effect: Effect
    sites: np.ndarray | None
    values: dict[str, np.ndarray | float | None]


class TouchEffect(Effect):
    """An effect on what a touch is before the skin feels it."""

    stage = "touch"

    def change(self, touches: pd.DataFrame, setting: Setting) -> pd.DataFrame:
        """`touches`, one row a frame: x_mm, y_mm, radius_mm, contrast, force_N; changed."""
        raise NotImplementedError


class SkinEffect(Effect):
    """An effect on the skin: its shape, its material, its electrodes."""

    stage = "skin"

    def change(self, geometry: Geometry, setting: Setting, minutes: float) -> Geometry:
        """The geometry `minutes` after the recording's start, changed."""
        raise NotImplementedError


class InstrumentEffect(Effect):
    """An effect on voltages, between the electrodes and the file."""

    stage = "instrument"

    def change(
        self, voltage: np.ndarray, setting: Setting, channels: np.ndarray, force_N: np.ndarray
    ) -> np.ndarray:
        """Readings of `voltage` (N, M) V, channels (M, 4), at the forces (N,)."""
        raise NotImplementedError

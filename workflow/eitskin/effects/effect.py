"""What an effect is: physics written once, for the simulator to apply and the diagnosis to fit."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from eitskin.effects.identity import Identity
from eitskin.physics.force_history import ForceHistory
from eitskin.physics.geometry import Geometry
from eitskin.physics.outline import inside_mm
from eitskin.physics.skin import Skin

STAGES = ("touch", "skin", "wiring", "instrument", "clock")
SITES = ("electrodes", "drives", "measures", "channels")
DRIVERS = ("static", "force", "time", "load-direction", "position", "amplitude", "scan-order")
VOLTS = {"V": 1.0, "1/V²": -2.0}  # units that are powers of a reading's
OF_READING = (*VOLTS, "S", "S/N")  # and those that are a current over one
ORDER = {
    "touch": ("force", "memory", "contact"),
    "wiring": ("leak", "open", "swap"),
    "instrument": ("common mode", "gain", "mixing", "offset", "mains", "converter"),
}


@dataclass(frozen=True)
class Parameter:
    """One parameter: its unit, the value at which the effect does nothing, and its bounds.

    neutral None: there is no such value and one must be given, unless `optional`: it may be left
    out. scale: the size of a typical change, the prior's sd, in the unit; of the logarithm where
    `low` is above 0. of_reading: it is that of a recording whose readings are 1 V at 1 A, and any
    other's goes with its median reading and its current; the unit is one of OF_READING. dense: one
    value a site rather than one for all. whole: a whole number, which no fit can move.
    """

    unit: str
    neutral: float | None
    low: float
    high: float
    scale: float = 1.0
    dense: bool = True
    optional: bool = False
    whole: bool = False
    of_reading: bool = False


@dataclass(frozen=True)
class Combination:
    """What readings may determine of several parameters that they do not determine each.

    parameters: their names; amounts: by name the values, 0 where the effect does nothing, and
    units of the combination at values of the parameters; finding: a diagnosis' sentence at these
    values, with the amounts as placeholders too.
    """

    parameters: tuple[str, ...]
    amounts: Callable[[dict], dict[str, tuple[float, str]]]
    finding: Callable[[dict], str]


class Effect:
    """One effect: class attributes say what it is, one method for its stage says what it does.

    name: the field's term; composite: whether it is a combination of others, which a diagnosis
    names instead; polar: (size, angle, m), a pair of parameters that are polar coordinates of m
    times the angle. stage: where it enters, one of STAGES in this order; order: its place within
    the stage, one of ORDER[stage]; driver: what it varies with, one of DRIVERS; sites: the kinds
    of place it may be confined to, the first being the usual one; site_number: how many it
    needs, or None; parameters by name; source: who described it; mend: what to do at the bench;
    confusable: names that look alike.

    finding: a diagnosis' sentence, for an experimentalist. Its {site} becomes the sites in words,
    {key} a parameter with its interval, {key:%} as a percentage, {phase:number} as the first of so
    many directions evenly around; of {one|several} the one that agrees with the number of sites;
    [a part] is left out where a parameter in it is, or may be nothing beside one that is something.
    opposite: a phrase of `finding`, and what stands there where all values of the one parameter
    are below 0, which are then said without their sign.
    combination: what readings may determine of several parameters where they do not determine each.
    shown_by: the recording that would show the effect where another could not, as a noun phrase.

    What a diagnosis asks of it. needs: keys of the skin without which it is no candidate where the
    skin is touched; far: coordinates from which a fit begins where nobody touches, because no
    tangent leads to it; last_resort: where it is tried only for readings that are not those of the
    skin that is believed, its name and one that may come with it, how many times the usual changes
    are typical then, and coordinates from which fits begin; common: whether one value for all sites
    is this effect, not another's; either: parameters that are laws of their own, of which a
    diagnosis names one; tone: whether it is a steady tone, whose `frequency_Hz` a periodogram
    finds; disc: whether it multiplies the conductivity by `contrast` within a disc at `x_mm`,
    `y_mm` of `radius_mm`; on_outlines: whether it is modelled on skins that are no discs;
    beside_inner: and on skins with electrodes inside;
    identities: other causes of the same readings, which a diagnosis names beside it.
    """

    name: str
    stage: str
    order: str | None = None
    driver: str
    sites: tuple[str, ...] = ()
    site_number: int | None = None
    parameters: dict[str, Parameter]
    source: str
    mend: str
    finding: str
    opposite: tuple[str, str] | None = None
    combination: Combination | None = None
    shown_by: str
    confusable: tuple[str, ...] = ()
    composite = False
    polar: tuple[str, str, int] | None = None
    needs: tuple[str, ...] = ()
    far: tuple[float, ...] = ()
    last_resort: dict[str, tuple[float, tuple[float, ...]]] = {}
    common = True
    either: tuple[str, ...] = ()
    tone = False
    disc = False
    on_outlines = True
    beside_inner = True
    identities: tuple[Identity, ...] = ()

    @property
    def several(self) -> bool:
        """Whether there may be more than one of it: discs, or entries with different values of a
        parameter that no fit can move."""
        return self.disc or any(parameter.whole for parameter in self.parameters.values())

    def is_modelled(self, skin: Skin) -> bool:
        """Whether it is modelled on a skin of this outline with these electrodes."""
        beside_electrodes = self.beside_inner or inside_mm(skin) is None
        return beside_electrodes and (self.on_outlines or skin.rim is None)

    def is_stated(self, skin: Skin, touched: bool) -> bool:
        """Whether what it needs is stated of the skin; touched: whether anybody touches it."""
        return not touched or all(getattr(skin, key) is not None for key in self.needs)

    def largest_body(self, geometry: Geometry) -> Geometry | None:
        """The body with the most degrees of freedom that fits of it try in place of a sheet, None
        where the skin stays a sheet; a body takes far more memory."""
        return None

    def neutral(self, key: str, skin: Skin) -> float | None:
        """A parameter's value at which the effect does nothing to `skin`, None: there is none."""
        return self.parameters[key].neutral

    def neutral_at(self, key: str, skin: Skin, sites: ArrayLike | None) -> float | None:
        """`neutral` of a parameter at definite sites, where these differ."""
        return self.neutral(key, skin)

    def site_groups(self, skin: Skin, kind: str, count: int) -> list[tuple[int, ...]]:
        """The sites of a kind, of which there are so many, by what the effect does there."""
        return [tuple(range(count))]

    def starts(self, skin: Skin, recorded_V: np.ndarray) -> list[dict[str, float]]:
        """Values of parameters without a neutral one from which fits start, one dict a start.

        recorded_V (N, M): what the board read.
        """
        return [{}]

    def sites_at_once(self, floating: bool) -> int:
        """How many sites it takes to change anything; floating: the source is tied to nothing."""
        return self.site_number or 1

    def recorded_values(self, force_max_N: float) -> dict[str, float]:
        """What optional parameters left out stand for, where a recording decides it."""
        return {}

    def finding_at(self, values: dict) -> str:
        """`finding`, or what says it better at these values of the parameters."""
        return self.finding

    def mend_at(self, values: dict) -> str:
        """`mend`, or what says it better at these values of the parameters."""
        return self.mend


@dataclass(frozen=True)
class Setting:
    """An effect at definite values: `sites` (S,) indices or None, `values` a number or (S,) each.

    kind: what the sites are, one of SITES, or None.
    """

    effect: Effect
    sites: np.ndarray | None
    values: dict[str, Any] = field(default_factory=dict)
    kind: str | None = None

    def at_channels(self, key: str, channels: np.ndarray) -> np.ndarray:
        """(M,): a parameter at each of the channels (M, 4), neutral where no site is."""
        assert self.kind is not None and self.sites is not None
        index = site_of(self.kind, channels)
        size = max(index.max(), self.sites.max()) + 1
        value = np.full(size, self.effect.parameters[key].neutral)
        value[self.sites] = self.values[key]
        return value[index]


def site_of(kind: str, channels: np.ndarray) -> np.ndarray:
    """(M,): the drive, measure or channel, whichever `kind` says, that each of the channels (M, 4)
    belongs to."""
    if kind == "channels":
        return np.arange(len(channels))
    return channels[:, {"drives": 0, "measures": 2}[kind]]


@dataclass(frozen=True)
class Frames:
    """N frames of M channels as an effect meets them.

    time_s, force_N (N,), the true force, 0 where untouched; channels (M, 4); history: the force in
    each press, None where no effect asks for it; frame_s: how long a frame takes, or None;
    force_max_N: the largest force reported, half of it is F_mid; above_sink_V (N, M): mean
    potential of the measuring pair above the sink, where an effect asks for it; seen_N (N, M): the
    force at each channel's moment, None where all see force_N.
    """

    time_s: np.ndarray
    force_N: np.ndarray
    channels: np.ndarray
    history: ForceHistory | None = None
    frame_s: float | None = None
    force_max_N: float = 0.0
    above_sink_V: np.ndarray | None = None
    seen_N: np.ndarray | None = None


@dataclass(frozen=True)
class Moment:
    """When and how a skin is touched: minutes from the start, N, mm (NaN where untouched)."""

    minutes: float
    force_N: float
    x_mm: float
    y_mm: float


START = Moment(0.0, 0.0, float("nan"), float("nan"))


class ForceEffect(Effect):
    """An effect on the force reported: what the true force is."""

    stage = "touch"
    order = "force"

    def change(self, history: ForceHistory, setting: Setting) -> ForceHistory:
        """The true force, of the force reported."""
        raise NotImplementedError


class TouchEffect(Effect):
    """An effect on what a touch is before the skin feels it."""

    stage = "touch"
    order = "contact"

    def change(self, touches: pd.DataFrame, setting: Setting, frames: Frames) -> pd.DataFrame:
        """`touches`, one row a frame: x_mm, y_mm, radius_mm, force_N (the true one), and whose
        product is the contrast, contrast_per_N and felt_N; changed."""
        raise NotImplementedError


class SkinEffect(Effect):
    """An effect on the skin: its shape, its material, its electrodes.

    on_contacts: it changes contacts, which point electrodes do not have. scaled_attribute: that of
    the geometry that it multiplies by its one parameter, at its sites and nowhere else, so that
    other effects have their derivatives by this attribute from it. Unless its driver is
    static it may follow all of a moment; between forces and between times it is smooth, or the
    simulator solves every frame's skin.
    """

    stage = "skin"
    on_contacts = False
    scaled_attribute: str | None = None

    def change(self, geometry: Geometry, setting: Setting, moment: Moment) -> Geometry:
        """The geometry at a moment, changed; a static effect's at any."""
        raise NotImplementedError


class WiringEffect(Effect):
    """An effect between the electrodes and the board: leaks, broken and exchanged wires."""

    stage = "wiring"

    def driven(self, drives: np.ndarray, setting: Setting) -> np.ndarray:
        """The electrodes (D, 2) between which the board's `drives` (D, 2) send their current."""
        return drives

    def change(
        self,
        potential: np.ndarray,
        setting: Setting,
        drives: np.ndarray,
        impedance: np.ndarray,
        sink_grounded: bool,
    ) -> np.ndarray:
        """Potentials (N, D, n) V per A, as the board has them; changed.

        drives (D, 2): electrodes of the skin between which the current flows; impedance (N, n, n)
        ohm: the skin's; sink_grounded: whether the source's sink is at 0 V, else it floats.
        """
        raise NotImplementedError


class LeakEffect(Effect):
    """An effect that takes current from the skin to ground; all of them act together.

    on_contact: it does so at the touch, as one more terminal; grounds_sink: the source does not
    float with it, whatever its owner believes.
    """

    stage = "wiring"
    order = "leak"
    on_contact = False
    grounds_sink = False

    def sites_at_once(self, floating: bool) -> int:
        """Two where the source floats: what one takes must come back through another."""
        return 2 if floating else 1

    def admittance(self, setting: Setting, force_N: np.ndarray, terminals: int) -> np.ndarray:
        """(N, terminals) S to ground at true forces (N,); the terminals are the electrodes, and
        the contact, which is the last, where `on_contact`."""
        raise NotImplementedError


class ClockEffect(Effect):
    """An effect on when each channel sees the state."""

    stage = "clock"

    def force_shift(self, setting: Setting, frames: Frames) -> np.ndarray:
        """(N,) N: force at the frame's last channel minus that at its first."""
        raise NotImplementedError


class InstrumentEffect(Effect):
    """An effect on readings; `on_readings`: on them alone, without the skin's potentials. One with
    `channels` among its sites has one parameter, and says its `slope`."""

    stage = "instrument"
    on_readings = True

    def change(self, voltage: np.ndarray, setting: Setting, frames: Frames) -> np.ndarray:
        """Readings (N, M) V of `voltage` (N, M) V."""
        raise NotImplementedError

    def slope(self, voltage: np.ndarray) -> np.ndarray:
        """(N, M): derivative of each of the readings (N, M) by the value at its own channel."""
        raise NotImplementedError

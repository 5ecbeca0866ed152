"""Electrodes that are not where the drawing has them."""

import numpy as np
from numpy.typing import ArrayLike

from eitskin.effects.anisotropy import axis_text
from eitskin.effects.effect import Moment, Parameter, Setting, SkinEffect
from eitskin.effects.identity import Identity, NamedEffect, OtherSide
from eitskin.errors import InputError
from eitskin.physics.geometry import Geometry
from eitskin.physics.outline import inside_mm, is_plain_disc, rim_numbers
from eitskin.physics.skin import Skin
from eitskin.quantities import number

RIM, INSIDE = ("shift_deg", "shift_mm"), ("dx_mm", "dy_mm")  # shifts of electrodes there
SHIFTED_INSIDE = (
    "{site} {sits|sit} [{dx_mm} along x, ][{dy_mm} along y, ]from where the drawing has {it|them}."
)
WAVE = 0.5  # of the variance of electrodes' shifts, that a stretch has at least: most of it


def stretched_gel(positions: NamedEffect) -> OtherSide | None:
    """Of electrodes each with its shift, most of it a wave A sin 2(phi - angle): one anisotropy,
    ln ratio = 2 A to first order, fitted on the full model."""
    if positions.scope != "dense" or not is_plain_disc(positions.skin):
        return None
    phi = np.radians(np.array(positions.skin.electrode_deg))
    shift = np.radians(positions.values["shift_deg"])
    wave = 2j * np.mean((shift - shift.mean()) * np.exp(-2j * phi))
    if 0.5 * abs(wave) ** 2 < WAVE * np.var(shift):
        return None
    values, gap = positions.fitted_substitute("anisotropy", 2.0 * np.conj(wave))
    sentence = (
        "Instead all electrodes may sit where the drawing has them, and the skin conduct"
        f" {number(values['ratio'])} times as well along {axis_text(values['angle_deg'])} as"
        " across, or the rim be an ellipse that carries them along,"
        f" {number(values['ratio'] ** 0.5)} times as long along"
        f" {axis_text(values['angle_deg'] + 90.0)} as across. Measure the rim with a ruler."
    )
    return OtherSide(gap, sentence)


class ElectrodePosition(SkinEffect):
    """electrode_deg + shift; on an outline a shift along the rim, by its length, and inside the
    skin one along x and y. Dense it is the paper's electrode jitter."""

    name = "electrode-position"
    driver = "static"
    sites = ("electrodes",)
    common = False  # that turns the skin, as the registration does
    parameters = {
        "shift_deg": Parameter("°", 0.0, -20.0, 20.0, scale=0.5, optional=True),
        "shift_mm": Parameter("mm", 0.0, -30.0, 30.0, scale=0.7, optional=True),
        "dx_mm": Parameter("mm", 0.0, -30.0, 30.0, scale=0.7, optional=True),
        "dy_mm": Parameter("mm", 0.0, -30.0, 30.0, scale=0.7, optional=True),
    }
    source = "Touch with Insight, § II-D"
    mend = "measure the angle of electrode {site}"
    finding = (
        "{site} {sits|sit} [{shift_deg}][{shift_mm} along the rim] from where the drawing has"
        " {it|them}, towards larger angles."
    )
    opposite = ("larger", "smaller")
    shown_by = "a recording with absolute values"
    confusable = ("domain-shape", "ellipse", "electrode-swap", "registration")
    identities = (Identity(("anisotropy", "domain-shape"), stretched_gel),)

    def neutral(self, key: str, skin: Skin) -> float | None:
        """0 of the shift of an electrode on the rim: in degrees on a disc, in mm on an outline."""
        if key in INSIDE:
            return None
        return 0.0 if (key == "shift_mm") == (skin.rim is not None) else None

    def neutral_at(self, key: str, skin: Skin, sites: ArrayLike | None) -> float | None:
        """As `neutral` on the rim; inside 0 of the shifts along x and y."""
        inner = inside_mm(skin)
        if inner is None or sites is None or np.isnan(inner[np.asarray(sites, int)]).any():
            return self.neutral(key, skin)
        return 0.0 if key in INSIDE else None

    def site_groups(self, skin: Skin, kind: str, count: int) -> list[tuple[int, ...]]:
        """The electrodes on the rim, and those inside."""
        on_rim = rim_numbers(skin, count)
        inner = np.setdiff1d(np.arange(count), on_rim)
        return [tuple(numbers.tolist()) for numbers in (on_rim, inner) if len(numbers)]

    def finding_at(self, values: dict) -> str:
        """Along x and y of electrodes inside."""
        return SHIFTED_INSIDE if values.get("dx_mm") is not None else self.finding

    def mend_at(self, values: dict) -> str:
        """By the angle, along the rim of an outline, or inside by x and y."""
        if values.get("dx_mm") is not None:
            return "measure where electrode {site} sits inside the skin"
        is_along_rim = values.get("shift_mm") is not None
        return "measure where electrode {site} sits along the rim" if is_along_rim else self.mend

    def change(self, geometry: Geometry, setting: Setting, moment: Moment) -> Geometry:
        """The geometry with electrodes shifted. Raises InputError for a shift along the
        rim of one inside, and for one along x or y of one on the rim."""
        assert setting.sites is not None
        shift: dict[str, np.ndarray] = {
            key: np.asarray(value) for key, value in setting.values.items() if np.any(value)
        }
        for keys, numbers, place, expected in (
            (RIM, geometry.inner, "inside the skin", "dx_mm and dy_mm for it"),
            (INSIDE, geometry.on_rim, "on the rim", "shift_deg or shift_mm for it"),
        ):
            alien = np.intersect1d(setting.sites, numbers)
            if len(alien) and any(key in shift for key in keys):
                actual = f"electrode {alien[0]}, {place}"
                raise InputError("effect electrode-position", "sites", actual, expected)
        if any(key in shift for key in INSIDE):
            assert geometry.electrode_inside_mm is not None
            place_mm = geometry.electrode_inside_mm.copy()
            place_mm[setting.sites] += shift.get("dx_mm", 0.0) + 1j * shift.get("dy_mm", 0.0)
            geometry = geometry.with_values(electrode_inside_mm=place_mm)
        angle = geometry.electrode_deg.copy()
        angle[setting.sites] += shift.get("shift_deg", 0.0)
        angle[setting.sites] += np.degrees(shift.get("shift_mm", 0.0) / geometry.radius_mm)
        return geometry.with_values(electrode_deg=angle)

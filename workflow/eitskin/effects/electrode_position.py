"""Electrodes that are not where the drawing has them."""

import numpy as np

from eitskin.effects.anisotropy import axis_text
from eitskin.effects.effect import Moment, Parameter, Setting, SkinEffect
from eitskin.effects.identity import Identity, NamedEffect, OtherSide
from eitskin.errors import InputError
from eitskin.physics.geometry import Geometry
from eitskin.physics.outline import is_plain_disc
from eitskin.physics.skin import Skin
from eitskin.quantities import number

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
        "As well all electrodes may sit where the drawing has them, and the gel conduct"
        f" {number(values['ratio'])} times as well along {axis_text(values['angle_deg'])} as"
        " across, or the rim be an ellipse that carries them along,"
        f" {number(values['ratio'] ** 0.5)} times as long along"
        f" {axis_text(values['angle_deg'] + 90.0)} as across. Measure the rim with a ruler."
    )
    return OtherSide(gap, sentence)


class ElectrodePosition(SkinEffect):
    """electrode_deg + shift; on an outline a shift along the rim, by its length. Dense it is the
    paper's electrode jitter."""

    name = "electrode-position"
    driver = "static"
    sites = ("electrodes",)
    rim_only = True
    common = False  # that turns the skin, as the registration does
    parameters = {
        "shift_deg": Parameter("°", 0.0, -20.0, 20.0, scale=0.5, optional=True),
        "shift_mm": Parameter("mm", 0.0, -30.0, 30.0, scale=0.7, optional=True),
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
        """0 of the shift in degrees on a disc, in mm on an outline."""
        return 0.0 if (key == "shift_mm") == (skin.rim is not None) else None

    def mend_at(self, values: dict) -> str:
        """By the angle, or along the rim of an outline."""
        is_along_rim = values.get("shift_mm") is not None
        return "measure where electrode {site} sits along the rim" if is_along_rim else self.mend

    def change(self, geometry: Geometry, setting: Setting, moment: Moment) -> Geometry:
        """The geometry with electrodes shifted. Raises InputError for one inside the skin."""
        assert setting.sites is not None
        inside = np.intersect1d(setting.sites, geometry.inner)
        if len(inside):
            actual = f"electrode {inside[0]}, inside the skin"
            raise InputError("effect electrode-position", "sites", actual, "electrodes on the rim")
        angle = geometry.electrode_deg.copy()
        shift_deg, shift_mm = (setting.values.get(key) for key in ("shift_deg", "shift_mm"))
        if shift_deg is not None:
            angle[setting.sites] += shift_deg
        if shift_mm is not None:
            angle[setting.sites] += np.degrees(shift_mm / geometry.radius_mm)
        return geometry.with_values(electrode_deg=angle)

"""A place where the skin conducts better, or worse, than elsewhere."""

import numpy as np

from eitskin.effects.effect import Combination, Moment, Parameter, Setting, SkinEffect
from eitskin.physics.geometry import Geometry, Patch
from eitskin.physics.skin import Skin

LATTICE_PLACES = 37  # from which fits on an outline start


def _equivalent_radius(values: dict) -> dict[str, tuple[float, str]]:
    """Radius of the hole, or of the perfect conductor, with the same dipole in an even current:
    r^2 (c - 1) / (c + 1) of a disc (Isaacson, IEEE Trans. Med. Imaging 5, 1986)."""
    contrast = values["contrast"]
    share = abs(contrast - 1.0) / (contrast + 1.0)
    return {"equivalent_radius_mm": (float(values["radius_mm"] * np.sqrt(share)), "mm")}


def _dipole_finding(values: dict) -> str:
    """The place and its dipole, which is all that a small disc changes."""
    comparison, equivalent = (
        ("worse", "hole") if values["contrast"] < 1.0 else ("better", "perfect conductor")
    )
    return (
        f"The skin conducts {comparison} about the place x = {{x_mm}}, y = {{y_mm}} than"
        f" elsewhere: it bends the current as a {equivalent} of radius {{equivalent_radius_mm}}"
        " would. How large the place is, and by how much it differs, cannot be told apart."
    )


class ConductivityPatch(SkinEffect):
    """sigma * contrast within a disc; touches multiply what they find there."""

    name = "conductivity-patch"
    driver = "static"
    disc = True
    parameters = {
        "x_mm": Parameter("mm", None, -1e4, 1e4, scale=10.0, dense=False),
        "y_mm": Parameter("mm", None, -1e4, 1e4, scale=10.0, dense=False),
        "radius_mm": Parameter("mm", None, 0.1, 1e4, scale=0.3, dense=False),
        "contrast": Parameter("1", 1.0, 1e-2, 100.0, scale=0.3, dense=False),
    }
    source = "Isaacson 1986"
    mend = "look for a bubble, a crack or a dry spot near the place named, and cast the gel again"
    finding = (
        "The skin conducts {contrast} times as well within {radius_mm} of the place x = {x_mm}, y"
        " = {y_mm} as elsewhere."
    )
    combination = Combination(("radius_mm", "contrast"), _equivalent_radius, _dipole_finding)
    shown_by = "absolute values, with touches all over the skin"
    confusable = ("conductivity-gradient", "domain-shape")

    def starts(self, skin: Skin, recorded_V: np.ndarray) -> list[dict[str, float]]:
        """Places on the skin, in rings a quarter of its radius apart; on an outline, on a lattice
        of as many."""
        assert skin.radius_mm is not None
        if skin.rim is not None:
            places = skin.rim.lattice(LATTICE_PLACES).tolist()
            radius_mm = 0.15 * float(np.sqrt(skin.rim.area_mm2 / np.pi))
            return [{"x_mm": p.real, "y_mm": p.imag, "radius_mm": radius_mm} for p in places]
        rings = [(0.0, 1), (0.25, 6), (0.5, 12), (0.75, 18)]
        places = [
            share * skin.radius_mm * np.exp(2j * np.pi * k / count)
            for share, count in rings
            for k in range(count)
        ]
        radius_mm = 0.15 * skin.radius_mm
        return [{"x_mm": p.real, "y_mm": p.imag, "radius_mm": radius_mm} for p in places]

    def change(self, geometry: Geometry, setting: Setting, moment: Moment) -> Geometry:
        """The geometry with the patch beside those that it has."""
        return geometry.with_values(patches=(*geometry.patches, Patch(**setting.values)))

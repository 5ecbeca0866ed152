"""A gel that conducts better in one direction."""

import numpy as np

from eitskin.effects.effect import Moment, Parameter, Setting, SkinEffect
from eitskin.effects.identity import Identity, NamedEffect, OtherSide, Substitute
from eitskin.physics.geometry import Geometry
from eitskin.physics.outline import is_plain_disc
from eitskin.quantities import number

HARMONICS = 16  # of a rim, the most that a domain-shape may have
RIM_PHI = np.linspace(0.0, 2.0 * np.pi, 4096, endpoint=False)  # 256 points of the highest harmonic
OUTLINE = (
    "domain-shape",
    "electrode-position",
    "electrode-width",
    "contact-impedance",
    "anisotropy",
)


def carried_outline(
    geometry: Geometry, base: Geometry, ratio: float, angle_deg: float
) -> list[Substitute]:
    """Effects on `base`, a disc, that give the outline of `geometry` stretched, at equal area,
    ratio^(-1/4) along the angle and ratio^(1/4) across, its electrodes carried along and each with
    the contact conductance that it had.

    With x' = A x, det A = 1, the conductivity becomes A sigma A^T (Lionheart 1997): the stretch
    takes an anisotropy of ratio and angle away. Exact but for one thing: an even contact impedivity
    is uneven along a stretched electrode, by |A t| of its tangent t; its mean is kept.
    """
    plane = geometry.with_values(anisotropy_ratio=ratio, anisotropy_deg=angle_deg)

    def image(phi: np.ndarray) -> np.ndarray:
        return plane.unfold(geometry.rim(phi))

    def image_angle(phi: np.ndarray) -> np.ndarray:
        return phi + np.angle(image(phi) * np.exp(-1j * phi))

    from scipy.interpolate import CubicSpline  # slow to import: see `physics.rim_curve`

    angle, radius = image_angle(RIM_PHI), np.abs(image(RIM_PHI)) / base.radius_mm
    closed = np.append(angle, angle[0] + 2.0 * np.pi), np.append(radius, radius[0])
    even = (RIM_PHI - angle[0]) % (2.0 * np.pi) + angle[0]
    spectrum = np.fft.fft(CubicSpline(*closed, bc_type="periodic")(even) - 1.0) / len(even)
    substitutes = []
    for k in range(HARMONICS + 1):
        size, phase = abs(spectrum[k]) * (2.0 if k else 1.0), -np.degrees(np.angle(spectrum[k]))
        values = {"harmonic": k, "amplitude": size, "phase_deg": phase}
        substitutes.append(Substitute("domain-shape", values))
    half = geometry.electrode_width_mm / (2.0 * geometry.radius_mm)
    phi = np.radians(geometry.electrode_deg)
    lower_edge, upper_edge = image_angle(phi - half), image_angle(phi + half)
    shift = np.degrees(0.5 * (lower_edge + upper_edge)) - base.electrode_deg
    by_name: dict[str, dict] = {"electrode-position": {"shift_deg": shift}}
    if not geometry.points:
        node, weight = np.polynomial.legendre.leggauss(16)
        slope = geometry.rim(phi[:, None] + half[:, None] * node, 1)
        stretch = (np.abs(plane.unfold(slope)) @ weight) / (np.abs(slope) @ weight)
        contact = geometry.contact_impedivity_ohm_m2 / base.contact_impedivity_ohm_m2
        by_name["electrode-width"] = {"width_mm": base.radius_mm * (upper_edge - lower_edge)}
        by_name["contact-impedance"] = {"ratio": contact * stretch}
    sites = np.arange(len(phi))
    substitutes += [Substitute(name, v, sites, "electrodes") for name, v in by_name.items()]
    return substitutes


def axis_text(axis_deg: float) -> str:
    """The direction of an axis in words."""
    return f"{number(round(axis_deg % 180.0, 1) % 180.0)}°"


def elliptic_rim(anisotropy: NamedEffect) -> OtherSide | None:
    """Of a disc: gel that conducts alike in all directions, its rim pressed out of round and the
    electrodes with it."""
    if not is_plain_disc(anisotropy.skin):
        return None
    geometry, base = anisotropy.geometry, Geometry.from_skin(anisotropy.skin)
    ratio, angle_deg = geometry.anisotropy_ratio, geometry.anisotropy_deg
    substitutes = carried_outline(geometry, base, ratio, angle_deg)
    diameter_mm = 2.0 * geometry.radius_mm * (1.0 + geometry.shape_cos.get(0, 0.0))
    long_mm, short_mm = diameter_mm * ratio**0.25, diameter_mm * ratio**-0.25
    sentence = (
        "Instead the skin may conduct alike in all directions and the rim be an ellipse that"
        f" carries its electrodes along, {number(long_mm / short_mm)} times as long along"
        f" {axis_text(angle_deg + 90.0)} as across ({number(long_mm)} and {number(short_mm)} mm, if"
        " its area is right). Measure it with a ruler."
    )
    voltage = anisotropy.simulated(substitutes, omitted=OUTLINE)
    return OtherSide(anisotropy.gap(voltage, electrodes_follow=True), sentence)


class Anisotropy(SkinEffect):
    """Conductivity along : across the angle is `ratio`, geometric mean kept."""

    name = "anisotropy"
    driver = "static"
    beside_inner = False
    parameters = {
        "ratio": Parameter("1", 1.0, 1.0, 10.0, scale=0.05, dense=False),
        "angle_deg": Parameter("°", 0.0, -360.0, 360.0, scale=90.0, dense=False),
    }
    polar = ("ratio", "angle_deg", 2)
    source = "Lionheart 1997"
    mend = "use a gel that was not stretched or poured in one direction"
    finding = "The skin conducts {ratio} times as well along {angle_deg} as across."
    shown_by = "absolute values, with touches at known places all over the skin"
    confusable = ("domain-shape", "ellipse")
    identities = (Identity(("domain-shape", "electrode-position"), elliptic_rim),)

    def change(self, geometry: Geometry, setting: Setting, moment: Moment) -> Geometry:
        """The geometry with its conductivity directed."""
        return geometry.with_values(
            anisotropy_ratio=setting.values["ratio"], anisotropy_deg=setting.values["angle_deg"]
        )

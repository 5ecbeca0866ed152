"""A rim that is no circle."""

import numpy as np

from eitskin.effects.anisotropy import axis_text
from eitskin.effects.effect import Moment, Parameter, Setting, SkinEffect
from eitskin.effects.gain import EVERY_GAIN, scaled_readings
from eitskin.effects.identity import Identity, NamedEffect, OtherSide, Substitute
from eitskin.physics.geometry import Geometry
from eitskin.physics.outline import is_plain_disc
from eitskin.physics.skin import Skin
from eitskin.quantities import number

HARMONICS = 6  # highest harmonic from which a fit starts
RIM = np.linspace(0.0, 2.0 * np.pi, 512, endpoint=False)
SHIFTED = "The rim is {amplitude:%} of its radius off centre, towards {phase_deg:harmonic}."
OVAL = (
    "The rim is an oval: its half axis along {phase_deg:harmonic} is {amplitude:%} longer than the"
    " radius, that across as much shorter."
)
NEWTON_STEPS = 8  # from the same angle; converges quadratically for rims near a disc


def directed_gel(shape: NamedEffect) -> OtherSide | None:
    """Of a rim of harmonic 2, its electrodes' angles kept: a circle of gel that conducts better
    across the rim's long axis, by ln ratio = 2 amplitude, to first order. Conformal maps to the
    circle move the electrodes by amplitude sin(2 phi - phase) in both cases."""
    if shape.values["harmonic"] != 2 or not is_plain_disc(shape.skin):
        return None
    ratio = float(np.exp(2.0 * shape.values["amplitude"]))
    angle_deg = 0.5 * shape.values["phase_deg"] + 90.0
    tensor = Substitute("anisotropy", {"ratio": ratio, "angle_deg": angle_deg})
    sentence = (
        f"Instead the skin may be round, and conduct {number(ratio)} times as well along"
        f" {axis_text(angle_deg)} as across. Measure the rim with a ruler."
    )
    return OtherSide(shape.gap(shape.simulated([tensor])), sentence)


def _conductivity_ratio(shape: NamedEffect) -> float | None:
    """Of harmonic 0: the factor of the conductivity that changes readings as the size does."""
    if shape.values["harmonic"] != 0 or not is_plain_disc(shape.skin):
        return None
    phase = float(np.cos(np.radians(shape.values["phase_deg"])))
    return 1.0 / (1.0 + shape.values["amplitude"] * phase)


def scaled_currents(shape: NamedEffect) -> OtherSide | None:
    """Of a size: all currents, or all amplifiers, and the conductivity with them."""
    ratio = _conductivity_ratio(shape)
    return None if ratio is None else scaled_readings(shape, ratio)


def scaled_contacts(shape: NamedEffect) -> OtherSide | None:
    """Of a size: the impedance of all contacts."""
    ratio = _conductivity_ratio(shape)
    if ratio is None:
        return None
    contacts = Substitute("contact-impedance", {"ratio": ratio}, shape.electrodes, "electrodes")
    sentence = (
        f"Instead the skin may have its size and every contact {number(ratio)} times the impedance"
        " that is assumed. Measure the skin with a ruler."
    )
    return OtherSide(shape.gap(shape.simulated([contacts])), sentence)


class DomainShape(SkinEffect):
    """r(phi) = R (1 + amplitude cos(harmonic phi - phase)); electrode edges keep their angles.

    One entry a harmonic; harmonic 0 is the size. With carried 1, a round rim was pressed into this
    shape: electrode edges keep their shares of its length, and turn by nothing in the mean.
    """

    name = "domain-shape"
    driver = "static"
    parameters = {
        "harmonic": Parameter("1", None, 0, 16, dense=False, whole=True),
        "amplitude": Parameter("1", 0.0, 0.0, 0.3, scale=0.02, dense=False),
        "phase_deg": Parameter("°", 0.0, -360.0, 360.0, scale=90.0, dense=False),
        "carried": Parameter("1", None, 0, 1, dense=False, whole=True, optional=True),
    }
    polar = ("amplitude", "phase_deg", 1)
    source = "Nissinen, Kolehmainen, Kaipio 2011"
    mend = "measure the rim"
    finding = (
        "The rim is no circle: it bulges at {harmonic} places by {amplitude:%} of its radius, the"
        " first at {phase_deg:harmonic}."
    )
    shown_by = "absolute values, with touches at known places along the rim"
    confusable = ("anisotropy", "ellipse", "electrode-position", "conductivity-patch")
    identities = (
        Identity(("anisotropy",), directed_gel),
        Identity(EVERY_GAIN, scaled_currents),
        Identity(("contact-impedance",), scaled_contacts),
    )

    def starts(self, skin: Skin, recorded_V: np.ndarray) -> list[dict[str, float]]:
        """The size and the harmonics that a rim is likely to have, drawn wrongly or pressed."""
        harmonics: list[dict[str, float]] = [{"harmonic": k} for k in range(HARMONICS + 1)]
        if skin.rim is not None:
            return harmonics
        return harmonics + [{"harmonic": k, "carried": 1} for k in range(2, HARMONICS + 1)]

    def finding_at(self, values: dict) -> str:
        """Harmonic 0 is a size, 1 a shift, 2 an oval by its half axes, a higher one bulges."""
        if values["harmonic"] == 0:
            larger = np.cos(np.radians(values["phase_deg"])) > 0
            size = "larger" if larger else "smaller"
            return f"The skin is {{amplitude:%}} {size} than it should be."
        text = {1: SHIFTED, 2: OVAL}.get(values["harmonic"], self.finding)
        return f"{text[:-1]}, its electrodes carried along." if values.get("carried") else text

    def change(self, geometry: Geometry, setting: Setting, moment: Moment) -> Geometry:
        """The geometry with this harmonic added to its rim."""
        k = int(setting.values["harmonic"])
        amplitude, phase = setting.values["amplitude"], np.radians(setting.values["phase_deg"])
        cosines, sines = dict(geometry.shape_cos), dict(geometry.shape_sin)
        cosines[k] = cosines.get(k, 0.0) + amplitude * np.cos(phase)
        if k > 0:
            sines[k] = sines.get(k, 0.0) + amplitude * np.sin(phase)
        shaped = geometry.with_values(shape_cos=cosines, shape_sin=sines)
        return _carried(geometry, shaped) if setting.values.get("carried") else shaped


def _carried(geometry: Geometry, shaped: Geometry) -> Geometry:
    """`shaped` with electrode edges at the shares of the rim's length that they have in
    `geometry`."""
    half = geometry.electrode_width_mm / (2.0 * geometry.radius_mm)
    edges = np.radians(geometry.electrode_deg) + np.array([-1.0, 1.0])[:, None] * half
    target = _length(geometry, edges)[0]
    lower_edge, upper_edge = edges.copy()
    for _ in range(NEWTON_STEPS):
        length, rate = _length(shaped, np.array([lower_edge, upper_edge]))
        lower_edge, upper_edge = np.array([lower_edge, upper_edge]) - (length - target) / rate
    return shaped.with_values(
        electrode_deg=np.degrees(0.5 * (lower_edge + upper_edge)),
        electrode_width_mm=geometry.radius_mm * (upper_edge - lower_edge),
    )


def _length(geometry: Geometry, phi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Length of the rim up to angles phi (any shape), scaled to 2 pi in all and equal to phi in
    the mean over the rim, and its derivative by phi."""
    spectrum = np.fft.rfft(np.abs(geometry.rim(RIM, 1)))[: len(RIM) // 4] / len(RIM)
    k = np.arange(1, len(spectrum))
    wave = 2.0 * spectrum[1:] / spectrum[0].real * np.exp(1j * k * np.asarray(phi)[..., None])
    return phi + (wave / (1j * k)).sum(axis=-1).real, 1.0 + wave.sum(axis=-1).real

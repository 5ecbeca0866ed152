"""The named effects, implemented a second time from their definitions.

A law is {name, [electrodes | drives | measures | channels], parameters}, the configuration's form;
a parameter is a number or a list with one number for each site. `named` selects laws by name.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from witness.curves import OutlineShape, Shape
from witness.outlines import Outline

SITES = ("electrodes", "drives", "measures", "channels")


def named(laws: list[dict], name: str) -> Iterator[dict]:
    """The parameters of every law of a name."""
    return (law.get("parameters", {}) for law in laws if law["name"] == name)


def _sites(law: dict, count: int) -> np.ndarray:
    listed = [law[kind] for kind in SITES if law.get(kind)]
    return np.array(listed[0] if listed else range(count), dtype=int)


def _at_sites(laws: list[dict], name: str, key: str, count: int) -> Iterator[tuple]:
    """The sites of every law of a name, and the parameter's values at them."""
    for law in laws:
        if law["name"] == name:
            sites = _sites(law, count)
            yield sites, np.broadcast_to(law["parameters"][key], len(sites))


# ---- touch


def force_change(laws: list[dict]) -> tuple[float, float]:
    """force-offset, N, and force-lag, s."""
    offset = sum(p["offset_N"] for p in named(laws, "force-offset"))
    return offset, sum(p["lag_s"] for p in named(laws, "force-lag"))


def skew_fraction(laws: list[dict]) -> float:
    """frame-skew."""
    return sum(p["fraction"] for p in named(laws, "frame-skew"))


def steps(force: np.ndarray, press: np.ndarray) -> np.ndarray:
    """(N,) N: the mean of the force's steps before and after a frame within its press, one-sided at
    the ends of the press."""
    step = np.zeros(len(force))
    for label in np.unique(press[press >= 0]):
        rows = np.flatnonzero(press == label)
        for i, row in enumerate(rows):
            around = rows[max(i - 1, 0) : i + 2]
            if len(around) > 1:
                step[row] = np.mean(np.diff(force[around]))
    return step


def felt_force(
    laws: list[dict], force: np.ndarray, followed: Callable[[float], np.ndarray]
) -> np.ndarray:
    """The force, N, that determines the contrast, after relaxation and contact-law.
    followed(tau_s): the relaxing part m, (N,) N."""
    felt = force
    for p in named(laws, "relaxation"):
        felt = felt - p["fraction"] * followed(p["tau_s"])
    for p in named(laws, "contact-law"):
        felt = np.sign(felt) * np.abs(felt) ** p["exponent"]
    return felt


def contrast_factor(laws: list[dict], force: np.ndarray, peak: np.ndarray) -> np.ndarray:
    """(N,): touch-contrast and hysteresis."""
    factor = np.ones(len(force))
    for p in named(laws, "touch-contrast"):
        factor = factor * p["ratio"]
    for p in named(laws, "hysteresis"):
        share = np.divide(force, peak, out=np.ones(len(force)), where=peak > 0)
        factor = factor * (1.0 + p["fraction"] * (1.0 - share))
    return factor


def radius_factor(laws: list[dict], force: np.ndarray) -> np.ndarray:
    """(N,): contact-area-growth and probe-radius."""
    factor = np.ones(len(force))
    for p in named(laws, "contact-area-growth"):
        factor = factor * np.where(force > 0, force, 1.0) ** p["exponent"]
    for p in named(laws, "probe-radius"):
        factor = factor * p["ratio"]
    return factor


def true_place(laws: list[dict], place: np.ndarray) -> np.ndarray:
    """(N,) complex mm: registration."""
    for p in named(laws, "registration"):
        turn = np.exp(1j * np.radians(p.get("rotation_deg", 0.0)))
        place = turn * place + complex(p.get("dx_mm", 0.0), p.get("dy_mm", 0.0))
    return place


def grounding(laws: list[dict], force: np.ndarray) -> np.ndarray:
    """(N,) S: indenter-grounding."""
    return sum((p["siemens_per_N"] for p in named(laws, "indenter-grounding")), 0.0) * force


# ---- skin


def outline(laws: list[dict], radius_mm: float, curve: Outline | None = None) -> Shape:
    """domain-shape, anisotropy, conductivity-gradient of a disc, or of the skin within a curve.
    Raises ValueError for two anisotropies."""
    harmonics: dict[int, complex] = {}
    for p in named(laws, "domain-shape"):
        k = int(p["harmonic"])
        phase = 0.0 if k == 0 else np.radians(p.get("phase_deg", 0.0))
        harmonics[k] = harmonics.get(k, 0.0) + p["amplitude"] * np.exp(1j * phase)
    directed = list(named(laws, "anisotropy"))
    if len(directed) > 1:
        raise ValueError("one anisotropy at most")
    ratio = (directed[0]["ratio"], directed[0]["angle_deg"]) if directed else (1.0, 0.0)
    tilt = sum(
        p["relative_across"] * np.exp(1j * np.radians(p["angle_deg"]))
        for p in named(laws, "conductivity-gradient")
    )
    if curve is not None:
        return OutlineShape(radius_mm, harmonics, ratio, complex(tilt), outline=curve)
    return Shape(radius_mm, harmonics, ratio, complex(tilt))


def electrodes(
    laws: list[dict], deg: np.ndarray, width_mm: np.ndarray, radius_mm: float
) -> tuple[np.ndarray, np.ndarray]:
    """Angles and widths (n,): electrode-position, along a rim of length 2 pi radius_mm by its angle
    or by length, and electrode-width."""
    deg, width_mm = np.array(deg, float), np.array(width_mm, float)
    for key, unit_deg in (("shift_deg", 1.0), ("shift_mm", np.degrees(1.0 / radius_mm))):
        stated = [law for law in laws if key in law.get("parameters", {})]
        for sites, shift in _at_sites(stated, "electrode-position", key, len(deg)):
            deg[sites] += unit_deg * shift
    for sites, width in _at_sites(laws, "electrode-width", "width_mm", len(deg)):
        width_mm[sites] = width
    return deg, width_mm


def impedivity(
    laws: list[dict], z: np.ndarray, minutes: np.ndarray, force: np.ndarray, distance_mm: np.ndarray
) -> np.ndarray:
    """(N, n) ohm m2: contact-impedance, contact-drift, force-dependent-impedance.

    z (n,); minutes, force (N,); apart (N, n) mm, from each electrode's centre to the contact's.
    """
    z = np.broadcast_to(z, distance_mm.shape).copy()
    n = distance_mm.shape[1]
    for sites, ratio in _at_sites(laws, "contact-impedance", "ratio", n):
        z[:, sites] *= ratio
    for sites, rate in _at_sites(laws, "contact-drift", "per_minute", n):
        z[:, sites] *= 1.0 + minutes[:, None] * rate
    for law in laws:
        if law["name"] == "force-dependent-impedance":
            sites = _sites(law, n)
            range_mm = law["parameters"].get("range_mm")
            decay = (
                np.ones(distance_mm.shape)
                if range_mm is None
                else np.exp(-((distance_mm / range_mm) ** 2))
            )
            rise = np.asarray(law["parameters"]["per_N"]) * decay[:, sites]
            z[:, sites] *= 1.0 + np.where(force[:, None] > 0, force[:, None] * rise, 0.0)
    return z


def conductivity(laws: list[dict], sigma: float, minutes: np.ndarray) -> np.ndarray:
    """(N,) S/m: conductivity-drift."""
    rate = sum(p["per_minute"] for p in named(laws, "conductivity-drift"))
    return sigma * (1.0 + rate * minutes)


def patches(laws: list[dict]) -> list[tuple[float, float, float, float]]:
    """x, y, radius, mm, and contrast - 1 of each conductivity-patch."""
    return [
        (p["x_mm"], p["y_mm"], p["radius_mm"], p["contrast"] - 1.0)
        for p in named(laws, "conductivity-patch")
    ]


# ---- wiring


def potentials(
    laws: list[dict],
    admittance: np.ndarray,
    leaking: np.ndarray,
    drives: np.ndarray,
    sink_grounded: bool,
) -> np.ndarray:
    """(N, D, n) V per A at the board, by nodal analysis: ground-leak, electrode-open, -swap.

    admittance (N, n, n) S, of the skin, ground at 0 where it is leaking (N,); drives (D, 2).
    """
    n = admittance.shape[-1]
    wires = np.arange(n)
    for law in laws:
        if law["name"] == "electrode-swap":
            a, b = law["electrodes"]
            wires[[a, b]] = wires[[b, a]]
    admittance = admittance.copy()
    for sites, siemens in _at_sites(laws, "ground-leak", "siemens", n):
        admittance[:, sites, sites] += siemens
        leaking = leaking | bool(np.any(siemens > 0))
    # Without a leak the level is free, and any conductance between all fixes it.
    admittance[~leaking] += np.abs(admittance).max() / n
    ends = wires[drives]
    current = np.zeros((n, len(drives)))
    current[ends[:, 0], np.arange(len(drives))] = 1.0
    current[ends[:, 1], np.arange(len(drives))] -= 1.0
    value = np.linalg.solve(admittance, current)
    if sink_grounded and leaking.any():
        for d, (_, sink) in enumerate(ends):
            free_nodes = np.delete(np.arange(n), sink)
            inner = admittance[leaking][:, free_nodes][:, :, free_nodes]
            value[leaking, :, d] = 0.0
            solved = np.linalg.solve(inner, current[free_nodes, d][:, None])[..., 0]
            value[np.ix_(leaking, free_nodes, np.array([d]))] = solved[..., None]
    value = np.swapaxes(value, 1, 2)
    for law in laws:
        if law["name"] == "electrode-open":
            intact = value.copy()
            for site in _sites(law, n):
                value[:, :, site] = np.delete(intact, site, axis=2).mean(axis=2)
                value[:, (ends == site).any(axis=1)] = 0.0
    return value[:, :, wires]


# ---- instrument


def _at_channels(
    laws: list[dict], name: str, key: str, neutral: float, channels: np.ndarray
) -> Iterator[np.ndarray]:
    """(M,) for every law of a name: the parameter at each channel."""
    columns = {"drives": channels[:, 0], "measures": channels[:, 2]}
    for law in laws:
        if law["name"] != name:
            continue
        kind = next((kind for kind in SITES if law.get(kind)), None)
        usual = {"drive-gain": "drives", "channel-gain": "channels"}.get(name, "measures")
        index = columns.get(kind or usual, np.arange(len(channels)))
        sites = _sites(law, index.max() + 1)
        table = np.full(max(index.max(), sites.max()) + 1, neutral)
        table[sites] = law["parameters"][key]
        yield table[index]


@dataclass(frozen=True)
class Readout:
    """The frames that an instrument reads: force (N, M) N at the time of each channel, time_s (N,),
    channels (M, 4), the frames' duration, and the recording's largest reported force."""

    force: np.ndarray
    time_s: np.ndarray
    channels: np.ndarray
    frame_s: float
    force_max_N: float


def instrument(
    laws: list[dict], volt: np.ndarray, above_sink: np.ndarray, readout: Readout
) -> np.ndarray:
    """(N, M) V: the readings of differences volt (N, M) V after the instrument's laws, in their
    order; above_sink (N, M) V: the measuring pair's mean potential above the sink.
    """
    channels = readout.channels
    for p in named(laws, "common-mode"):
        volt = volt + p["ratio"] * above_sink
    for name in ("drive-gain", "measurement-gain", "channel-gain"):
        for gain in _at_channels(laws, name, "gain", 1.0, channels):
            volt = volt * gain
    for p in named(laws, "force-dependent-gain"):
        middle = 0.5 * readout.force_max_N if p.get("F_mid_N") is None else p["F_mid_N"]
        volt = volt * (1.0 + p["per_N"] * (readout.force - middle))
    for p in named(laws, "crosstalk"):
        previous_channel, next_channel = np.roll(volt, 1, axis=1), np.roll(volt, -1, axis=1)
        volt = volt - 2.0 * p["epsilon"] * volt + p["epsilon"] * (previous_channel + next_channel)
    for p in named(laws, "multiplexer-memory"):
        volt = _remembered(volt, p["mu"])
    for shift in _at_channels(laws, "offset", "volt", 0.0, channels):
        volt = volt + shift
    count = volt.shape[1]
    moment = readout.time_s[:, None] + readout.frame_s * np.arange(count) / count
    for p in named(laws, "mains-interference"):
        angle = 2.0 * np.pi * p["frequency_Hz"] * moment + np.radians(p.get("phase_deg", 0.0))
        volt = volt + p["volt"] * np.sin(angle)
    for p in named(laws, "adc-nonlinearity"):
        volt = volt + (p.get("cubic") or 0.0) * volt**3
        if p.get("limit_V") is not None:
            volt = np.clip(volt, -p["limit_V"], p["limit_V"])
    return volt


def _remembered(volt: np.ndarray, mu: float) -> np.ndarray:
    """y_k = (1 - mu) v_k + mu y_(k-1), cyclic over the frame: a circulant system, solved by the
    discrete Fourier transform."""
    count = volt.shape[1]
    turn = np.exp(-2j * np.pi * np.arange(count // 2 + 1) / count)
    return np.fft.irfft(np.fft.rfft(volt, axis=1) * (1.0 - mu) / (1.0 - mu * turn), count, axis=1)

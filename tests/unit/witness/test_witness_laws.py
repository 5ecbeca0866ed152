"""The witness's laws against numbers worked out by hand."""

import numpy as np
import pytest

from witness import laws, outside
from witness.press import Press

CHANNELS = np.array([[0, 1, 2, 3], [0, 1, 3, 4], [1, 2, 3, 4], [1, 2, 4, 0]])


def law(name: str, _sites: dict | None = None, **parameters) -> dict:
    return {"name": name, **(_sites or {}), "parameters": parameters}


def read(items: list[dict], volt, above=0.0, force=0.0, force_max=0.0, time=0.0) -> np.ndarray:
    volt = np.atleast_2d(np.asarray(volt, float))
    above, force = (np.broadcast_to(np.asarray(v, float), volt.shape) for v in (above, force))
    time_s = np.full(len(volt), time)
    readout = laws.Readout(force, time_s, CHANNELS, 0.4, force_max)
    return laws.instrument(items, volt, above, readout)[0]


def press() -> Press:
    return Press.from_reports(np.array([1.0, 2.0, 4.0]), np.array([2.0, 6.0, 2.0]), 0.0, 0.0)


def test_force_within_a_press():
    times = [0.4, 0.75, 1.5, 3.0, 4.5, 6.0]
    assert [press().force(t) for t in times] == pytest.approx([0.0, 1.0, 4.0, 4.0, 1.0, 0.0])
    assert [press().peak(t) for t in times] == pytest.approx([0.0, 1.0, 4.0, 6.0, 6.0, 6.0])


def test_lag_and_offset():
    late = Press.from_reports(np.array([1.0, 2.0]), np.array([2.0, 6.0]), 0.5, 0.25)
    assert late.force(1.0) == pytest.approx(3.5)  # reported at 1.25: 3, and 0.5 more
    assert late.force(2.0) == pytest.approx(7.5)  # on at 4 N/s
    lowered = Press.from_reports(np.array([1.0, 2.0]), np.array([0.3, 6.0]), -0.5, 0.0)
    assert lowered.force(1.0) == 0.0


def test_relaxation_follows_its_equation():
    tau, step = 0.7, 1e-4
    m, t = 0.0, 0.5
    for _ in range(60000):
        m += step * (press().force(t + 0.5 * step) - m) / tau * (1 - 0.5 * step / tau)
        t += step
    assert press().followed(6.5, tau) == pytest.approx(m, abs=2e-4)
    constant = Press(np.array([0.0, 1e-9, 3.0]), np.array([0.0, 4.0, 4.0]))
    assert constant.followed(3.0, 1.5) == pytest.approx(4.0 * (1 - np.exp(-2.0)), rel=1e-6)


def test_touch_laws():
    force, peak = np.array([2.0, 4.0]), np.array([8.0, 4.0])
    assert laws.contrast_factor([law("hysteresis", fraction=0.2)], force, peak) == pytest.approx(
        [1.15, 1.0]
    )
    assert laws.contrast_factor([law("touch-contrast", ratio=1.5)], force, peak) == pytest.approx(
        [1.5, 1.5]
    )
    law_pair = [law("relaxation", fraction=0.5, tau_s=1.0), law("contact-law", exponent=2.0)]
    felt = laws.felt_force(law_pair, force, lambda tau: np.array([1.0, 2.0]) * tau)
    assert felt == pytest.approx([2.25, 9.0])
    grown = [law("contact-area-growth", exponent=0.5), law("probe-radius", ratio=2.0)]
    assert laws.radius_factor(grown, force) == pytest.approx([2 * 2**0.5, 4.0])
    turned = laws.true_place([law("registration", dx_mm=1.0, dy_mm=0.0, rotation_deg=90.0)], 2 + 0j)
    assert turned == pytest.approx(1 + 2j)
    assert laws.grounding([law("indenter-grounding", siemens_per_N=1e-3)], force) == pytest.approx(
        [2e-3, 4e-3]
    )


def test_frame_steps():
    press = np.array([-1, 0, 0, 0, -1, 1])
    force = np.array([0.0, 1.0, 3.0, 4.0, 0.0, 5.0])
    assert laws.steps(force, press) == pytest.approx([0.0, 2.0, 1.5, 1.0, 0.0, 0.0])


def test_skin_laws():
    shape = laws.outline(
        [
            law("domain-shape", harmonic=0, amplitude=0.1, phase_deg=50.0),
            law("domain-shape", harmonic=2, amplitude=0.05, phase_deg=90.0),
        ],
        50.0,
    )
    rim = np.abs(shape.rim(np.array([0.0, np.pi / 4])))
    assert rim == pytest.approx([1.1, 1.15])  # cos(0 - 90 deg), cos(90 deg - 90 deg)
    along = laws.outline([law("anisotropy", ratio=16.0, angle_deg=90.0)], 1.0)
    assert along.unfold(np.array([1j, 1.0])) == pytest.approx([0.5j, 2.0])
    tilt = laws.outline([law("conductivity-gradient", relative_across=0.4, angle_deg=0.0)], 1.0)
    assert tilt.slope() == pytest.approx(0.2)  # s = 1 + 0.4 x / 2 R
    items = [
        law("electrode-position", {"electrodes": [1]}, shift_deg=[2.0]),
        law("electrode-width", width_mm=3.0),
    ]
    deg, width = laws.electrodes(items, np.array([0.0, 90.0]), np.array([5.0, 5.0]), 60.0)
    assert deg.tolist() == [0.0, 92.0] and width.tolist() == [3.0, 3.0]
    along_rim = [law("electrode-position", {"electrodes": [1]}, shift_mm=[np.pi])]
    deg, _ = laws.electrodes(along_rim, np.array([0.0, 90.0]), np.array([5.0, 5.0]), 60.0)
    assert deg == pytest.approx([0.0, 93.0])  # 3 degrees of a rim of length 2 pi 60 mm


def test_contact_laws():
    minutes, force = np.array([0.0, 2.0]), np.array([0.0, 5.0])
    distance_mm = np.array([[10.0, 20.0], [10.0, 20.0]])
    items = [
        law("contact-impedance", {"electrodes": [0]}, ratio=[2.0]),
        law("contact-drift", per_minute=0.1),
        law("force-dependent-impedance", per_N=0.1, range_mm=20.0),
    ]
    z = laws.impedivity(items, np.full(2, 1e-3), minutes, force, distance_mm)
    assert z[0] == pytest.approx([2e-3, 1e-3])
    decay = 1 + 0.5 * np.exp([-0.25, -1.0])
    assert z[1] == pytest.approx([2e-3 * 1.2 * decay[0], 1e-3 * 1.2 * decay[1]])
    drift = laws.conductivity([law("conductivity-drift", per_minute=0.05)], 0.5, minutes)
    assert drift == pytest.approx([0.5, 0.55])


def ring(conductance: float = 1e-3) -> np.ndarray:
    """Admittance of three equal resistors in a ring."""
    return conductance * (3.0 * np.eye(3) - 1.0)[None]


def test_two_leaks_are_a_resistor_between_them():
    drives = np.array([[0, 1]])
    items = [law("ground-leak", {"electrodes": [0, 1]}, siemens=[2e-3, 2e-3])]
    potential = laws.potentials(items, ring(), np.array([False]), drives, False)
    # Through the ring 1.5 mS, beside it two times 2 mS in series.
    assert potential[0, 0, 0] - potential[0, 0, 1] == pytest.approx(
        1 / (1 / 667e0 + 1e-3), rel=1e-3
    )


def test_one_leak_needs_a_grounded_sink():
    drives = np.array([[0, 1]])
    items = [law("ground-leak", {"electrodes": [0]}, siemens=1e-3)]
    across = []
    for sink_grounded in (False, True):
        potential = laws.potentials(items, ring(), np.array([False]), drives, sink_grounded)
        across.append(potential[0, 0, 0] - potential[0, 0, 1])
    assert across == pytest.approx([2e3 / 3, 1 / (1.5e-3 + 1e-3)])


def test_wires():
    drives = np.array([[0, 1], [1, 2]])
    none = np.array([False])
    intact = laws.potentials([], ring(), none, drives, False)
    swapped = laws.potentials(
        [{"name": "electrode-swap", "electrodes": [0, 2]}], ring(), none, drives, False
    )
    assert swapped[0, 0] == pytest.approx(-intact[0, 1][[2, 1, 0]])
    broken = laws.potentials(
        [{"name": "electrode-open", "electrodes": [2]}], ring(), none, drives, False
    )
    assert broken[0, 1].tolist() == [0.0, 0.0, 0.0]
    assert broken[0, 0, 2] == pytest.approx(intact[0, 0, :2].mean())


def test_gains_and_offsets():
    volt = [1.0, 2.0, 3.0, 4.0]
    assert read([law("drive-gain", {"drives": [1]}, gain=[2.0])], volt).tolist() == [1, 2, 6, 8]
    assert read([law("measurement-gain", {"measures": [3]}, gain=2.0)], volt).tolist() == [
        1,
        4,
        6,
        4,
    ]
    assert read([law("channel-gain", {"channels": [0]}, gain=[2.0])], volt).tolist() == [2, 2, 3, 4]
    assert read([law("offset", {"measures": [4]}, volt=[1.0])], volt).tolist() == [1, 2, 3, 5]
    assert read([law("offset", {"channels": [0]}, volt=[1.0])], volt).tolist() == [2, 2, 3, 4]
    assert read([law("common-mode", ratio=0.5)], volt, above=2.0).tolist() == [2, 3, 4, 5]
    forced = [law("force-dependent-gain", per_N=0.1)]
    assert read(forced, volt, force=7.0, force_max=10.0) == pytest.approx([1.2, 2.4, 3.6, 4.8])


def test_mixing():
    volt = np.array([1.0, 2.0, 3.0, 4.0])
    assert read([law("crosstalk", epsilon=0.1)], volt) == pytest.approx([1.4, 2.0, 3.0, 3.6])
    y = read([law("multiplexer-memory", mu=0.3)], volt)
    assert y == pytest.approx(0.7 * volt + 0.3 * np.roll(y, 1))


def test_converter_and_mains():
    assert read([law("adc-nonlinearity", cubic=0.5)], [1.0, -2.0, 0, 0]).tolist() == [1.5, -6, 0, 0]
    assert read([law("adc-nonlinearity", limit_V=1.5)], [1, -2, 2, 0]).tolist() == [1, -1.5, 1.5, 0]
    tone = [law("mains-interference", frequency_Hz=2.5, volt=2.0, phase_deg=90.0)]
    # Channels are read 0.1 s apart: a quarter of the period.
    assert read(tone, np.zeros(4), time=0.4) == pytest.approx([2.0, 0.0, -2.0, 0.0], abs=1e-12)


def test_order_in_the_instrument():
    items = [
        law("adc-nonlinearity", limit_V=30.0),
        law("offset", {"measures": [2]}, volt=[1.0]),
        law("drive-gain", {"drives": [0]}, gain=[10.0]),
        law("common-mode", ratio=1.0),
    ]
    assert read(items, [1.0, 9.0, 0, 0], above=1.0).tolist() == [21.0, 30.0, 1.0, 1.0]


def test_outside_readings():
    volt = np.array([[1.0, 4.0, 3.0, 2.0]])
    settled = outside.SlowSettling(0.5).converted(volt, None, None)
    assert settled.tolist() == [[2.0, 3.0, 2.0, 3.0]]
    ranged = outside.GainRange(0.5, threshold_V=2.5).converted(volt, None, None)
    assert ranged.tolist() == [[1.0, 6.0, 4.5, 2.0]]
    even = outside.EvenConverter(0.5, reference_V=2.0).converted(volt, None, None)
    assert even.tolist() == [[1.25, 8.0, 5.25, 3.0]]

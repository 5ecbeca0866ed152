"""Bodies against the sheet, finite elements in three dimensions, themselves, and real tanks."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.special import ive

from eitskin.data import importers
from eitskin.effects import EFFECTS
from eitskin.effects.settings import settings as effect_settings
from eitskin.effects.settings import site_counts
from eitskin.errors import InputError
from eitskin.physics.depth import (
    DEPTH_ACCURACIES,
    DepthAccuracy,
    DepthForward,
    Quadrature,
    Span,
    cylinder_response,
    legendre_overlap,
    span,
)
from eitskin.physics.forward import ACCURACIES, Forward, channel_values
from eitskin.physics.geometry import Geometry
from eitskin.physics.protocol import channel_table
from eitskin.physics.skin import Skin
from eitskin.physics.solver import forward_model
from eitskin.physics.touch import Touch
from eitskin.simulate.readings import simulate
from reference_body import body_impedance
from shared_data import shared_data
from witness.boundary import Disc
from witness.curves import Shape
from witness.deep import DeepBody, Depth

ANGLES = 22.5 * np.arange(16)
CHANNELS = channel_table(16)
FINER = DepthAccuracy(14, 4.5, 40.0, 14, 1e-7, 1e-9, Quadrature(10, 1e-8))
PYEIDORS = "2026-03-14-21-38-31_1_10.00_55uA_1000Hz.csv"


def body(depth=60.0, width=10.0, z=1e-2, n=16, **values):
    return Geometry(100.0, depth, 0.5, 360.0 / n * np.arange(n), width, z, **values)


def all_channels(n):
    every = np.arange(n)
    k, j = (a.ravel() for a in np.meshgrid(every, every, indexing="ij"))
    return np.column_stack([k, (k + 1) % n, j, (j + 1) % n])


def relative(found, expected, channels):
    found, expected = channel_values(found, channels), channel_values(expected, channels)
    return np.abs(found - expected).max() / np.median(np.abs(expected))


def overall(found, expected, channels):
    found, expected = channel_values(found, channels), channel_values(expected, channels)
    return np.linalg.norm(found - expected) / np.linalg.norm(expected)


def test_the_cylinders_response_against_bessel_functions():
    k = np.array([1e-3, 0.7, 5.0, 40.0, 300.0])
    n = np.arange(13)[:, None]
    expected = ive(n, k) / (k * 0.5 * (ive(n + 1, k) + ive(np.abs(n - 1), k)))
    np.testing.assert_allclose(cylinder_response(500, k)[:13], expected, rtol=1e-12)
    np.testing.assert_allclose(cylinder_response(12, k)[:13], expected, rtol=1e-6)
    flat = cylinder_response(12, np.zeros(1))[:, 0]
    assert np.isinf(flat[0])
    np.testing.assert_allclose(flat[1:], 1.0 / np.arange(1, 13), rtol=1e-14)


def test_overlapping_legendre_polynomials():
    at_rest = legendre_overlap(5, np.zeros(1))[:, :, 0]
    np.testing.assert_allclose(at_rest, np.diag(0.5 / (2 * np.arange(5) + 1)), atol=1e-15)
    lag = np.array([-1.3, 0.4, 2.0])
    shifted = legendre_overlap(2, lag)
    reach = 1 - np.abs(lag) / 2
    np.testing.assert_allclose(shifted[0, 0], reach / 2, atol=1e-15)
    np.testing.assert_allclose(shifted[1, 0], lag * reach / 4, atol=1e-15)


TANK = Skin(100.0, 60.0, 0.5, tuple(ANGLES), 10.0, 1e-2, 1e-3, 0.0, electrode_height_mm=10.0)


@pytest.mark.parametrize("accuracy", ["train", "diagnose"])
def test_full_height_is_the_sheet(accuracy):
    geometry, touches = body(3.0), [Touch(20.0, 31.0, 7.5, 4.0)]
    sheet, found = Forward(geometry, accuracy), DepthForward(geometry, None, accuracy)
    assert np.array_equal(found.transfer_impedance(touches), sheet.transfer_impedance(touches))
    assert found.parameters() == sheet.parameters()


@pytest.mark.parametrize(("accuracy", "bound"), [("train", 1e-5), ("diagnose", 1e-8)])
@pytest.mark.parametrize("depth", [3.0, 60.0])
def test_electrodes_over_the_whole_depth_by_the_double_series(depth, accuracy, bound):
    geometry = body(depth)
    sheet = Forward(geometry, accuracy).transfer_impedance()
    coupled = replace(DEPTH_ACCURACIES[accuracy], coupled_tolerance=1e-300)
    found = DepthForward(geometry, Span(depth, depth / 2), accuracy, coupled).transfer_impedance()
    assert relative(found, sheet, CHANNELS) < bound
    assert overall(found, sheet, all_channels(16)) < bound


@pytest.mark.parametrize(
    ("geometry", "heights"),
    [
        (body(n=8), Span(10.0, 30.0)),
        (body(n=8, z=1e-3), Span(10.0, 12.0)),
        (body(n=8, width=30.0), Span(20.0, 10.0)),
        (body(150.0, n=8), Span(50.0, 70.0)),
        (body(3.0, n=8, width=5.0), Span(1.5, 1.0)),
    ],
)
@pytest.mark.parametrize(("accuracy", "bound"), [("train", 5e-3), ("diagnose", 2e-4)])
def test_convergence(geometry, heights, accuracy, bound):
    channels = channel_table(8)
    finest = replace(ACCURACIES["diagnose"], electrode_order=20)
    finer = DepthForward(geometry, heights, finest, FINER).transfer_impedance()
    found = DepthForward(geometry, heights, accuracy).transfer_impedance()
    assert relative(found, finer, channels) < bound
    assert overall(found, finer, all_channels(8)) < bound


def test_an_ideal_body_is_circulant_and_the_same_upside_down():
    found = DepthForward(body(), Span(10.0, 20.0), "train").transfer_impedance()
    size = np.abs(found).max()
    assert np.abs(np.roll(found, (1, 1), (0, 1)) - found).max() < 1e-12 * size
    assert np.abs(found[::-1, ::-1] - found).max() < 1e-12 * size
    turned = DepthForward(body(), Span(10.0, 40.0), "train").transfer_impedance()
    assert np.abs(turned - found).max() < 1e-9 * size


@settings(max_examples=10)
@given(
    depth=st.floats(2.0, 200.0),
    share=st.floats(0.1, 0.9),
    place=st.floats(0.0, 1.0),
    seed=st.integers(0, 1000),
)
def test_reciprocity_and_power_whatever_the_electrodes(depth, share, place, seed):
    rng = np.random.default_rng(seed)
    geometry = Geometry(
        100.0,
        depth,
        0.5,
        45.0 * np.arange(8) + rng.normal(0, 2, 8),
        rng.uniform(5, 20, 8),
        10.0 ** rng.uniform(-3, -1, 8),
    )
    height = share * depth
    heights = Span(height, 0.5 * height + place * (depth - height))
    found = DepthForward(geometry, heights, "train").transfer_impedance()
    assert np.abs(found - found.T).max() < 1e-12 * np.abs(found).max()
    pairs = np.eye(8) - np.roll(np.eye(8), 1, axis=1)
    assert np.linalg.eigvalsh(pairs @ found @ pairs.T)[1] > 0


def test_a_thin_body_tends_to_the_sheet():
    """Electrodes of half the height are in the end a sheet's with twice the contact impedivity."""
    gaps = []
    for depth in (5.0, 2.5, 1.25):
        sheet = Forward(body(depth, z=2e-2), "train").transfer_impedance()
        found = DepthForward(body(depth), Span(depth / 2, depth / 4), "train").transfer_impedance()
        gaps.append(relative(found, sheet, CHANNELS))
    assert (np.diff(np.log(gaps)) < np.log(0.6)).all() and gaps[-1] < 1e-3


def test_against_finite_elements_in_three_dimensions():
    expected = body_impedance(5, 0.4, 0.1, 0.6, 0.05, 0.25, (0, 1), (1, 1))
    geometry = Geometry(1e3, 600.0, 1.0, 72.0 * np.arange(5), 400.0, 0.1)
    found = DepthForward(geometry, Span(200.0, 150.0)).transfer_impedance()
    assert relative(found, expected, channel_table(5)) < 5e-4
    assert overall(found, expected, all_channels(5)) < 2e-2
    sheet = Forward(geometry).transfer_impedance()
    assert relative(sheet, expected, channel_table(5)) > 1e-2


@pytest.mark.parametrize("factor", [0.2, 5.0])
def test_a_touch_through_the_depth_against_finite_elements(factor):
    """A wide one that comes within half a depth of the electrodes."""
    setup = (5, 0.4, 0.1, 0.6, 0.1, 0.4, (0, 1), (1, 1))
    expected = body_impedance(*setup, (0.7, factor)) - body_impedance(*setup)
    geometry = Geometry(1e3, 600.0, 1.0, 72.0 * np.arange(5), 400.0, 0.1)
    forward = DepthForward(geometry, Span(300.0, 250.0))
    touch = Touch(0.0, 0.0, 700.0, factor - 1.0)
    found = forward.transfer_impedance([touch]) - forward.transfer_impedance()
    assert overall(found, expected, channel_table(5)) < 2e-3
    at_once = forward.place(0.0, 0.0, 700.0).impedance_change(np.array([factor - 1.0]))[0]
    np.testing.assert_allclose(at_once, found, atol=1e-10 * np.abs(found).max())


@pytest.fixture(scope="module")
def witnessed():
    """By place: its change of every channel in the witness's body, contrasts 2 and -0.5."""
    depth = Depth(20.0, 8.0, 7.0, 20, 10.0)
    deep = DeepBody(Shape(60.0), ANGLES, np.full(16, 6.0), depth, 3.0)
    contact = deep.contact(np.full(16, 1.0 / 60.0))
    places, found = [(47.0, 8.0, 7.5), (40.0, 22.0, 7.5), (30.0, -5.0, 12.0)], {}
    for place in places:
        there = deep.place([Disc(*place)])
        bare, *touched = (there.admittance(contact, [c]) for c in (0.0, 2.0, -0.5))
        values = [
            channel_values(np.linalg.inv(5e-3 * (a + a.T) + 1.0), CHANNELS)
            for a in (bare, *touched)
        ]
        found[place] = np.array(values[1:]) - values[0]
    return found


@pytest.mark.long
@pytest.mark.parametrize(("accuracy", "bound"), [("train", 2e-3), ("diagnose", 1e-4)])
def test_touches_near_the_rim_against_the_witness(witnessed, accuracy, bound):
    """A sheet's multipoles alone are off by 3e-3 to 0.04 of the change."""
    geometry = Geometry(60.0, 20.0, 0.5, ANGLES, 6.0, 2e-3)
    forward = DepthForward(geometry, Span(8.0, 7.0), accuracy)
    for place, expected in witnessed.items():
        found = forward.place(*place).channel_change(CHANNELS, np.array([2.0, -0.5]))
        size = np.abs(expected).max(axis=1)
        assert (np.abs(found - expected).max(axis=1) < bound * size).all()


@pytest.mark.parametrize("z_mm", [10.0, 7.0])
def test_of_full_height_no_touch_is_felt_in_depth(z_mm):
    geometry, place = body(20.0), (83.0, 5.0, 10.0)
    sheet = Forward(geometry).place(*place).impedance_change(np.array([3.0]))[0]
    coupled = replace(DEPTH_ACCURACIES["diagnose"], coupled_tolerance=1e-300)
    forward = DepthForward(geometry, Span(20.0, 10.0), depth_accuracy=coupled)
    deep = forward.place(*place).impedance_change(np.array([3.0]))
    assert overall(deep[0], sheet, all_channels(16)) < 1e-8
    part = DepthForward(geometry, Span(14.0, z_mm)).place(*place).impedance_change(np.array([3.0]))
    assert overall(part[0], sheet, all_channels(16)) > 1e-3


def test_two_touches_of_a_body_as_one_at_a_time():
    """Reciprocal, and each a touch of the other's body: far apart, the changes add up."""
    forward = DepthForward(body(30.0), Span(10.0, 10.0))
    left, right = Touch(-84.0, 8.0, 10.0, 2.0), Touch(84.0, 10.0, 9.0, -0.5)
    bare = forward.transfer_impedance()
    alone = [forward.transfer_impedance([touch]) - bare for touch in (left, right)]
    both = forward.transfer_impedance([left, right]) - bare
    assert np.abs(both - both.T).max() < 1e-12 * np.abs(both).max()
    assert overall(both, sum(alone), all_channels(16)) < 2e-2
    halves = forward.transfer_impedance([left, replace(right, contrast=1e-9)]) - bare
    assert overall(halves, alone[0], all_channels(16)) < 1e-7


def test_a_clipped_touch_couples_to_the_mean_over_the_depth_alone():
    forward = DepthForward(body(20.0), Span(10.0, 8.0), "train")
    clipped, whole = (forward.edge(Touch(x, 0.0, 10.0)) for x in (95.0, 85.0))
    assert clipped.mass.shape == clipped.edge.mass.shape
    assert len(whole.mass) > len(whole.edge.mass)
    assert forward.place(95.0, 0.0, 10.0).impedance_change(np.array([1.0])).any()


def test_current_that_enters_over_a_touch_of_a_body():
    forward = DepthForward(body(20.0), Span(10.0, 8.0))
    place = (83.0, 5.0, 10.0)
    terminal, modes = forward.contact(*place), forward.place(*place)
    contrast = np.array([2.0])
    found = terminal.impedance_change(contrast)[0]
    expected = modes.impedance_change(contrast)[0]
    assert np.abs(found - found.T).max() < 1e-12 * np.abs(found).max()
    np.testing.assert_allclose(found[:-1, :-1], expected, atol=1e-10 * np.abs(expected).max())


@pytest.mark.long
def test_derivatives_against_differences_of_bodies():
    rng = np.random.default_rng(0)
    geometry = Geometry(
        100.0,
        60.0,
        0.5,
        45.0 * np.arange(8) + rng.normal(0, 1, 8),
        10.0 + rng.normal(0, 0.3, 8),
        5e-3 * np.exp(rng.normal(0, 0.3, 8)),
    )
    heights = {"electrode_height_mm": 12.0, "electrode_z_mm": 25.0}
    forward = DepthForward(geometry, Span(*heights.values()), "train")
    slopes = forward.derivatives()
    assert list(slopes) == forward.parameters() and len(slopes) == 4 + 3 * 8
    steps = {"contact_impedivity_ohm_m2": 1e-5, "conductivity_S_per_m": 1e-3}
    for name in forward.parameters()[:4] + [f"{p.partition('[')[0]}[3]" for p in slopes][4::8]:
        kind, _, index = name.rstrip("]").partition("[")
        step, sides = steps.get(kind, 0.02), []
        for sign in (1.0, -1.0):
            moved, span_of = geometry, dict(heights)
            if kind in heights:
                span_of[kind] += sign * step
            else:
                value = np.array(getattr(geometry, kind), float)
                value[int(index) if index else ()] += sign * step
                moved = geometry.with_values(**{kind: value if index else float(value)})
            sides.append(DepthForward(moved, Span(*span_of.values()), "train").transfer_impedance())
        difference = (sides[0] - sides[1]) / (2.0 * step)
        assert overall(slopes[name], difference, all_channels(8)) < 1e-4, name
    with pytest.raises(InputError, match="an untouched one"):
        forward.derivatives([Touch(0.0, 0.0, 5.0, 1.0)])


@pytest.mark.parametrize(
    ("geometry", "heights", "message"),
    [
        (body(width=0.0, z=0.0), Span(10.0, 30.0), "electrode_width_mm"),
        (body(shape_cos={2: 0.02}), Span(10.0, 30.0), "a circular rim"),
        (body(stretch_x=1.02), Span(10.0, 30.0), "a circular rim"),
        (body(), Span(0.0, 30.0), "electrode_height_mm"),
        (body(), Span(10.0, 4.0), "-1 to 9 mm"),
        (body(), Span(10.0, 56.0), "within 0 to 60 mm"),
        (body(width=39.2), Span(10.0, 30.0), "further apart"),
    ],
)
def test_what_is_no_body_is_refused(geometry, heights, message):
    with pytest.raises(InputError, match=message):
        DepthForward(geometry, heights)


def test_what_a_geometry_says_of_its_heights():
    def said(deep=True, **values):
        return span(Geometry.from_skin(replace(TANK, **values)).with_values(deep=deep))

    assert said(electrode_height_mm=None) is None
    assert said(deep=False) is None
    assert said() == Span(10.0, 30.0)
    assert said(electrode_z_mm=20.0) == Span(10.0, 20.0)


def test_the_third_dimension_as_an_effect():
    """Frames of a tank, by the list of effects: the body's voltages at the depth given."""
    channels = channel_table(16)
    states = pd.DataFrame(
        {"time_s": [0.0], "touch": [False], "x_mm": [np.nan], "y_mm": [np.nan]}
    ).assign(force_N=0.0, probe_mm=np.nan)
    for parameters, depth in (({}, 60.0), ({"depth_mm": 45.0}, 45.0)):
        item = {"name": "third-dimension", "parameters": parameters}
        chosen = effect_settings([item], site_counts(channels), (0, 0))
        found = simulate(states, np.array([-1]), TANK, channels, chosen, "train")[0]
        geometry = Geometry.from_skin(TANK).with_values(thickness_mm=depth)
        body = DepthForward(geometry, Span(10.0, depth / 2), "train")
        assert np.array_equal(found, 1e-3 * body.voltages(channels))
    sheet = simulate(states, np.array([-1]), TANK, channels, [], "train")[0]
    assert np.abs(found - sheet).max() > 0.05 * np.abs(sheet).max()


@settings(max_examples=12, deadline=None)
@given(
    st.floats(2.0, 25.0),
    st.floats(0.05, 0.9),
    st.floats(10.0, 200.0),
    st.integers(0, 10_000),
    st.sampled_from(["train", "diagnose"]),
)
def test_modes_that_electrodes_do_not_share_change_little(width, share, depth, seed, accuracy):
    """Whatever the electrodes: unlike widths, contacts and spacing."""
    draw = np.random.default_rng(seed).uniform(-1.0, 1.0, (3, 8))
    geometry = Geometry(
        100.0, depth, 0.5, 45.0 * np.arange(8) + 3.0 * draw[0], width * 1.1 ** draw[1],
        1e-2 * 2.0 ** draw[2], deep=True,
    )  # fmt: skip
    heights = Span(share * depth, 0.5 * depth)
    chosen = DEPTH_ACCURACIES[accuracy]
    uncondensed = replace(chosen, coupled_tolerance=1e-300)
    condensed = DepthForward(geometry, heights, accuracy)
    complete = DepthForward(geometry, heights, accuracy, uncondensed)
    assert condensed.electrodes.order <= complete.electrodes.order
    found, expected = condensed.transfer_impedance(), complete.transfer_impedance()
    assert relative(found, expected, channel_table(8)) < 30.0 * chosen.coupled_tolerance
    assert overall(found, expected, all_channels(8)) < chosen.coupled_tolerance


@pytest.mark.parametrize(("accuracy", "bound"), [("train", 3e-3), ("diagnose", 3e-4)])
@pytest.mark.parametrize(("width", "height"), [(10.0, 20.0), (25.0, 20.0), (25.0, 40.0)])
def test_modes_that_electrodes_do_not_share_hardly_change_a_touch(width, height, accuracy, bound):
    uncondensed = replace(DEPTH_ACCURACIES[accuracy], coupled_tolerance=1e-300)
    geometry, heights = body(n=8, width=width, deep=True), Span(height, 30.0)
    found, expected = (
        DepthForward(geometry, heights, accuracy, chosen)
        .place(86.0, 0.0, 9.0)
        .impedance_change(np.array([4.0]))[0]
        for chosen in (None, uncondensed)
    )
    assert np.abs(found - expected).max() < bound * np.abs(expected).max()


def test_good_contacts_take_more_modes_of_which_no_more_are_coupled():
    poor, good = (DepthForward(body(n=8, z=z), Span(10.0, 30.0), "train") for z in (1e-2, 1e-4))
    assert good.electrodes.modes > 3 * poor.electrodes.modes
    assert good.electrodes.size == poor.electrodes.size
    finer = replace(ACCURACIES["train"], electrode_order=12)
    finest = DepthForward(body(n=8, z=1e-4), Span(10.0, 30.0), finer, FINER).transfer_impedance()
    assert relative(good.transfer_impedance(), finest, channel_table(8)) < 5e-3


@pytest.mark.parametrize("z, least", [(None, 10.0), (5.0, 10.0), (13.0, 18.0), (40.0, 50.4)])
def test_depths_to_start_from_have_room_for_the_electrodes(z, least):
    """Where nobody knows the thickness; the simulation refuses electrodes beyond it."""
    skin = replace(TANK, thickness_mm=None, electrode_height_mm=4.0, electrode_z_mm=z)
    starts = EFFECTS["third-dimension"].starts(skin, np.zeros((1, 1)))
    depths = [start["depth_mm"] for start in starts]
    assert depths[0] == pytest.approx(least)
    assert depths[-1] == 100.0
    for depth in depths:
        geometry = Geometry.from_skin(replace(skin, thickness_mm=depth)).with_values(deep=True)
        assert np.isfinite(forward_model(geometry, "train").voltages(channel_table(16))).all()


# --- real tanks: untouched magnitudes away from the drive, one fitted scale


def tank(name):
    recording = importers.load(shared_data(name))
    return recording.channels, np.abs(recording.voltage + 1j * recording.quadrature).mean(axis=0)


def misfit(forward, channels, reading):
    """Residuals over the reading's norm."""
    model = np.abs(channel_values(forward.transfer_impedance(), channels))
    return (model * (model @ reading) / (model @ model) - reading) / np.linalg.norm(reading)


@pytest.mark.parametrize("z", [1e-4, 1e-1])
def test_the_drawn_iirc_tank_has_a_third_dimension(z):
    channels, reading = tank("iirc-tank/iirc_data_2006.mat")
    geometry = body(60.0, z=z)
    deep = DepthForward(geometry, Span(10.0, 30.0), "train")
    assert np.linalg.norm(misfit(deep, channels, reading)) < 0.041
    assert np.linalg.norm(misfit(Forward(geometry, "train"), channels, reading)) > 0.06


@pytest.mark.parametrize(
    "name",
    [
        "lct-tank/homogeneous",
        f"pyeidors-tank/measurements/tank/2026-03-14_latest_tank_data/electrode01_metal/{PYEIDORS}",
    ],
)
def test_tanks_without_a_drawing_are_explained_by_depth_and_height(name):
    """Electrodes a quarter of the pitch wide; a sheet's, however wide, leave 0.09 and more."""
    channels, reading = tank(name)

    def residual(parameters):
        depth, share = np.exp(parameters[0]), parameters[1]
        heights = Span(share * depth, 0.5 * depth)
        return misfit(DepthForward(body(depth), heights, "train"), channels, reading)

    fit = least_squares(
        residual, [np.log(200.0), 0.2], bounds=([3.0, 0.02], [7.0, 0.98]), diff_step=1e-3
    )
    assert np.linalg.norm(fit.fun) < 0.025
    sheets = [Forward(body(width=w, z=1e-1), "train") for w in (10.0, 25.0, 38.0)]
    assert min(np.linalg.norm(misfit(s, channels, reading)) for s in sheets) > 0.09


def test_contacts_too_good_for_the_accuracy_are_refused():
    geometry = Geometry(80.0, 20.0, 0.5, ANGLES, 5.0, 1e-5)
    with pytest.raises(InputError, match=r"contact_impedivity_ohm_m2.*finer accuracy"):
        DepthForward(geometry, Span(6.0, 10.0), "train")

"""The references against each other, and against curved quadratic finite elements."""

from dataclasses import replace

import numpy as np
import pytest

import reference_disc as reference
from benchmark.finite_elements import FiniteElements
from eitskin.physics.protocol import channel_table
from symmetric_mesh import symmetric_disc_mesh

N = 16
ANGLES = 2 * np.pi * np.arange(N) / N
CHANNELS = channel_table(N)
RING = 0.4
FACTOR = 3.0
ECCENTRIC = (0.4 + 0.2j, 0.25)
WIDTH, CONTACT = 0.1, 0.05


def moved_ring(mesh, ring, centre, radius):
    """The mesh with its ring carried onto another circle, the rim held."""
    place = mesh.doflocs
    r = np.hypot(*place)
    unit = np.divide(place, r, out=np.zeros_like(place), where=r > 0)
    middle = np.array([[centre.real], [centre.imag]])
    t = np.clip((1.0 - r) / (1.0 - ring), 0.0, 1.0)
    outside = t * (middle + radius * unit) + (1.0 - t) * unit
    inside = r <= ring * (1.0 + 1e-12)
    return replace(mesh, doflocs=np.where(inside, middle + radius / ring * place, outside))


def on_ring_mesh(width, refinement, grading, touch):
    """Transfer impedance by curved quadratic elements; touch None, 'concentric' or 'eccentric'."""
    mesh, electrodes = symmetric_disc_mesh(N, width, refinement, grading, rings=(RING,))
    inside = np.hypot(*mesh.p[:, mesh.t].mean(axis=1)) < RING
    if touch == "eccentric":
        mesh = moved_ring(mesh, RING, *ECCENTRIC)
    conductance = np.where(inside & (touch is not None), FACTOR, 1.0)
    contact = CONTACT if width else None
    return FiniteElements(mesh, electrodes, contact, order=2).transfer_impedance(conductance)


def relative(found, exact):
    return np.max(abs(found - exact)) / np.median(abs(exact))


@pytest.mark.parametrize("factor", [0.1, 0.7, 4.0, 50.0])
def test_series_and_images_agree(factor):
    angles = np.random.default_rng(0).uniform(0, 2 * np.pi, 7)
    series = reference.points_concentric(angles, 0.6, factor)
    images = reference.points_concentric_by_images(angles, 0.6, factor)
    assert np.allclose(series, images, rtol=0, atol=1e-13, equal_nan=True)


def test_an_inclusion_that_is_none_changes_nothing():
    for impedance in (
        reference.points_concentric(ANGLES, 0.5, 1.0),
        reference.points_eccentric(ANGLES, 0.3 - 0.2j, 0.4, 1.0),
    ):
        plain = reference.points_homogeneous(ANGLES)
        found = reference.voltages(impedance, CHANNELS) - reference.voltages(plain, CHANNELS)
        assert np.max(abs(found)) < 1e-13


def test_the_moebius_map_centres_the_circle():
    for centre, radius in [(0.3 + 0.4j, 0.2), (-0.85, 0.1), (0.01j, 0.9)]:
        alpha, mapped = reference.disc_map(centre, radius)
        circle = centre + radius * np.exp(2j * np.pi * np.arange(12) / 12)
        image = (circle - alpha) / (1 - np.conj(alpha) * circle)
        assert np.allclose(abs(image), mapped, rtol=0, atol=1e-13)


def test_a_touch_at_the_rim_is_the_limit_of_touches_near_it():
    limit, near = (
        reference.voltages(impedance, CHANNELS)
        for impedance in (
            reference.points_touching(ANGLES, 0.1, 0.1, 5.0),
            reference.points_eccentric(ANGLES, (0.9 - 1e-8) * np.exp(0.1j), 0.1, 5.0),
        )
    )
    plain = reference.voltages(reference.points_homogeneous(ANGLES), CHANNELS)
    change = np.linalg.norm(limit - plain)
    assert np.linalg.norm(near - limit) < 2e-6 * change
    finer = reference.points_touching(ANGLES, 0.1, 0.1, 5.0, gap=2e-5)
    assert np.linalg.norm(reference.voltages(finer, CHANNELS) - limit) < 2e-6 * change


@pytest.mark.parametrize(
    ("touch", "exact", "reached"),
    [
        (None, reference.points_homogeneous(ANGLES), 1e-5),
        ("concentric", reference.points_concentric(ANGLES, RING, FACTOR), 1e-5),
        ("eccentric", reference.points_eccentric(ANGLES, *ECCENTRIC, FACTOR), 5e-5),
    ],
)
def test_closed_forms_equal_finite_elements_away_from_the_drive(touch, exact, reached):
    found = reference.voltages(on_ring_mesh(0.0, 2, 6, touch), CHANNELS)
    assert relative(found, reference.voltages(exact, CHANNELS)) < reached


@pytest.mark.long
@pytest.mark.parametrize("inclusion", [None, (RING, FACTOR), (0.8, 0.2)])
def test_both_series_of_complete_electrodes_agree(inclusion):
    exact, doubt = reference.complete_electrodes(N, WIDTH, CONTACT, inclusion, periods=200)
    assert doubt < 1e-8
    touch = inclusion and (0.0, *inclusion)
    other, doubt = reference.complete_touched(ANGLES, WIDTH, CONTACT, touch, harmonics=400)
    assert np.max(abs(exact - other)) < min(doubt, 2e-6)


def test_the_series_converges_with_order_two_and_extrapolation_beyond():
    exact, _ = reference.complete_electrodes(4, 0.6, CONTACT, periods=200)
    errors = [
        np.max(abs(reference.complete_series(4, 0.6, CONTACT, periods=p) - exact))
        for p in (50, 100)
    ]
    assert 1.8 < np.log2(errors[0] / errors[1]) < 2.1
    better, doubt = reference.complete_electrodes(4, 0.6, CONTACT, periods=25)
    assert np.max(abs(better - exact)) < min(doubt, errors[1] / 10)


def test_wide_contacts_of_high_impedance_pass_current_evenly():
    """z -> infinity: the current is uniform on each electrode, R = z / width + Neumann means."""
    z = 1e7
    found = reference.complete_series(4, 0.6, z, periods=400)
    m = np.arange(1, 200001)
    spread = np.sinc(0.5 * m * 0.6 / np.pi) ** 2 / (np.pi * m)
    turn = 0.5 * np.pi * np.arange(4)
    series = np.array([np.sum(spread * np.cos(m * t)) for t in turn])
    expected = series - series.mean()
    expected[0] += z / 0.6
    expected -= z / 0.6 / 4
    assert np.max(abs(found[0] - expected)) < 1e-6


@pytest.mark.long
@pytest.mark.parametrize(
    ("touch", "reached"), [(None, 2e-5), ("concentric", 2e-5), ("eccentric", 6e-5)]
)
def test_complete_electrodes_equal_finite_elements(touch, reached):
    if touch == "eccentric":
        exact, _ = reference.complete_touched(
            ANGLES, WIDTH, CONTACT, (*ECCENTRIC, FACTOR), harmonics=400
        )
    else:
        inclusion = (RING, FACTOR) if touch else None
        exact, _ = reference.complete_electrodes(N, WIDTH, CONTACT, inclusion, periods=100)
    found = on_ring_mesh(WIDTH, 1, 8, touch)
    assert np.max(abs(found - exact)) < reached
    found, exact = (reference.voltages(impedance, CHANNELS) for impedance in (found, exact))
    assert relative(found, exact) < 10 * reached


def test_turning_skin_and_touch_together_changes_nothing():
    angles = np.array([0.1, 0.9, 2.0, 3.3, 4.4, 5.5])
    widths = np.array([0.1, 0.2, 0.15, 0.3, 0.1, 0.25])
    contacts = np.array([0.05, 0.02, 0.1, 0.05, 0.03, 0.2])
    one = reference.complete_general(angles, widths, contacts, (0.5 + 0.3j, 0.2, 5.0), 200)
    turned = (0.5 + 0.3j) * np.exp(0.7j)
    two = reference.complete_general(angles + 0.7, widths, contacts, (turned, 0.2, 5.0), 200)
    assert np.max(abs(one - two)) < 1e-12
    assert np.max(abs(one - one.T)) < 1e-13

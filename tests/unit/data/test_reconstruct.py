from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eitskin.data import alignment, reconstruct
from eitskin.physics.geometry import even_angles
from eitskin.physics.protocol import channel_table
from eitskin.physics.skin import Skin

ACROSS = 40
CHANNELS, ANGLES = channel_table(16), even_angles(16)
PLACES = reconstruct.pixels(ACROSS)
JACOBIAN = reconstruct.jacobian(CHANNELS, ANGLES, PLACES, ACROSS)


def test_pixels_cover_the_disc():
    assert len(PLACES) * (2.0 / ACROSS) ** 2 == pytest.approx(np.pi, rel=0.02)
    assert np.abs(PLACES).max() < 1.0
    assert len(np.unique(PLACES)) == len(PLACES)


def test_pixels_sum_to_what_an_inner_disc_changes():
    """Against a polar quadrature, away from the electrodes' singularities."""
    fine = reconstruct.pixels(200, reach=0.7)
    nodes, weights = np.polynomial.legendre.leggauss(12)
    radius, turns = 0.35 * (nodes + 1.0), np.exp(2j * np.pi * np.arange(64) / 64)
    expected = sum(
        0.35 * weight * 2.0 * np.pi * r * alignment.sensitivity(CHANNELS, ANGLES, r * turns).mean(0)
        for r, weight in zip(radius, weights, strict=True)
    )
    total_change = reconstruct.jacobian(CHANNELS, ANGLES, fine, 200).sum(axis=1)
    np.testing.assert_allclose(total_change, expected, atol=0.01 * np.abs(expected).max())


@pytest.mark.parametrize("strength", [1e-3, 1.0, 100.0])
def test_noser_is_cheney_s_normal_equation(strength):
    small = JACOBIAN[:, ::7]
    normal = small.T @ small
    expected = np.linalg.solve(normal + strength * np.diag(np.diag(normal)), small.T)
    np.testing.assert_allclose(
        reconstruct.noser(small, strength), expected, atol=1e-9 * np.abs(expected).max()
    )


def touch(place, noise=0.003, seed=0):
    """What a small touch at a complex place changes, over a whole press of five forces, with noise
    over the largest change."""
    change = alignment.sensitivity(CHANNELS, ANGLES, np.array([place]))[0]
    draw = np.random.default_rng(seed).standard_normal((5, len(change)))
    return np.linspace(0.2, 1.0, 5)[:, None] * change + noise * np.abs(change).max() * draw


@settings(max_examples=12)
@given(radius=st.floats(0.0, 0.85), turn=st.floats(0.0, 2.0 * np.pi), seed=st.integers(0, 9))
def test_a_small_touch_lights_up_where_it_is(radius, turn, seed):
    """Readings grow towards the rim, and NOSER divides by them: its peak lies inward of a touch, by
    less than what electrodes resolve, half of their spacing. Each pixel over what a touch there
    would light it up, it peaks at the touch (Cauchy-Schwarz in the inner product that the prior
    makes), as the projection does: at one of the pixels around it.
    """
    place = radius * np.exp(1j * turn)
    change = touch(place, seed=seed)
    inverse = reconstruct.noser(JACOBIAN, reconstruct.strength(JACOBIAN, change))
    image = inverse @ change[-1]
    at_itself = (inverse * JACOBIAN.T).sum(axis=1)
    standardised = image * np.sqrt((JACOBIAN**2).sum(axis=0) / at_itself)
    projected = alignment.back_projection(JACOBIAN.T, change[-1:])[:, 0]
    cell = np.sqrt(2.0) * 2.0 / ACROSS
    assert abs(PLACES[image.argmax()] - place) < np.pi / 16
    assert abs(PLACES[standardised.argmax()] - place) < cell
    assert abs(PLACES[projected.argmax()] - place) < cell


def test_the_image_grows_with_the_touch():
    change = touch(0.4j)
    images = reconstruct.noser(JACOBIAN, 1.0) @ change.T
    assert np.all(np.diff(images.max(axis=0)) > 0)


def test_the_strength_minimises_what_cross_validation_says():
    change = touch(0.5 + 0.1j, noise=0.02)
    best_strength = reconstruct.strength(JACOBIAN, change)

    def score(strength):
        hat = JACOBIAN @ reconstruct.noser(JACOBIAN, strength)
        residual = change - change @ hat.T
        return (residual**2).mean() / (1.0 - np.trace(hat) / len(hat)) ** 2

    assert score(best_strength) < min(score(best_strength / 1.3), score(best_strength * 1.3))


def test_more_noise_asks_for_more_strength():
    quiet, loud = (reconstruct.strength(JACOBIAN, touch(0.5, noise)) for noise in (0.001, 0.1))
    assert loud > 3.0 * quiet


def test_pixels_lie_on_an_outline():
    stated = dict.fromkeys(f.name for f in fields(Skin))
    outline = {"corners_mm": [[0, 0], [80, 0], [80, 40], [0, 40]]}
    pixels = reconstruct.skin_pixels(
        Skin.from_metadata({**stated, "outline": outline, "electrode_s": [0.1]}), 8
    )
    assert sorted({*pixels.real}) == [5.0 + 10.0 * k for k in range(8)]
    assert sorted({*pixels.imag}) == [5.0, 15.0, 25.0, 35.0] and len(pixels) == 32
    disc = reconstruct.skin_pixels(Skin.from_metadata(stated | {"radius_mm": 80.0}), 8)
    np.testing.assert_array_equal(disc, 80.0 * reconstruct.pixels(8))

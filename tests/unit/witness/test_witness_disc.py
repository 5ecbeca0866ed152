"""The witness's series against analytic solutions, more nodes and boundary integrals."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from witness import boundary, disc
from witness.boundary import Disc, Radial, Resolution
from witness.cases import draw
from witness.curves import Shape
from witness.disc import Nodes, concentric

N, R_MM, WIDTH_MM = 16, 70.0, 6.0
DEG = 22.5 * np.arange(N)


def body(nodes: Nodes | None = None) -> disc.Body:
    return disc.Body(Shape(R_MM), DEG, np.full(N, WIDTH_MM), nodes)


def admittance(skin, discs, contrasts, z_mm: float = 1.0) -> np.ndarray:
    return skin.place(discs).admittance(skin.contact(np.full(N, z_mm / R_MM)), contrasts)


def test_log_of_polynomials():
    """int -log|t - t'| dt' and int -t' log|t - t'| dt' over -1 to 1."""
    t, weight, operator = Nodes().logarithm()
    up, down = (1 + t) * np.log(1 + t), (1 - t) * np.log(1 - t)
    assert weight.sum() == pytest.approx(2.0, abs=1e-11)
    assert operator.sum(axis=1) == pytest.approx(2.0 - up - down, abs=1e-10)
    second = t + 0.5 * (1 - t**2) * np.log((1 + t) / (1 - t))
    assert operator @ t == pytest.approx(second, abs=1e-10)


@settings(deadline=None)
@given(st.floats(0.0, 0.9), st.floats(0.01, 0.99))
def test_map_makes_it_concentric(centre, share):
    radius = share * (1.0 - centre)
    pole, rho = concentric(centre, radius)
    z = centre + radius * np.exp(1j * np.linspace(0.0, 6.0, 20))
    assert np.abs((z - pole) / (1.0 - pole * z)) == pytest.approx(rho, abs=1e-12)


def test_bad_contacts_see_the_fourier_series():
    """For large zeta, I = (zeta / 2h + r)^-1 U but for zeta^-2 of it, r the mean potential on one
    electrode for an even current from another, sum sinc^2(m h) cos(m lag) / (m pi)."""
    half = 0.5 * WIDTH_MM / R_MM
    m = np.arange(1, 200001)
    share = np.sinc(m * half / np.pi) ** 2 / (m * np.pi)
    r = np.array([(share * np.cos(m * np.radians(lag))).sum() for lag in DEG])
    r = r[(np.arange(N)[:, None] - np.arange(N)) % N]
    skin, admittances = body(), []
    for zeta in (10.0, 100.0):
        exact = np.linalg.inv(np.eye(N) * zeta / (2.0 * half) + r)
        exact -= np.outer(exact.sum(axis=1), exact.sum(axis=0)) / exact.sum()
        mine = skin.place([]).admittance(skin.contact(np.full(N, zeta)), [])
        admittances.append(np.abs(mine - exact).max() / np.abs(exact).max())
    assert admittances[0] < 1e-5 and admittances[1] < 1.1e-2 * admittances[0]


def test_turns_with_its_electrodes():
    skin = body()
    unturned = admittance(skin, [Disc(50.0, 10.0, 7.5)], [2.0])
    place = (50.0 + 10.0j) * np.exp(1j * np.pi / 8.0)
    turned = admittance(skin, [Disc(place.real, place.imag, 7.5)], [2.0])
    assert np.abs(np.roll(unturned, (1, 1), (0, 1)) - turned).max() < 1e-12


@pytest.mark.parametrize("z_mm", [0.03, 1.0])
def test_converged(z_mm):
    """To 1e-11 of the largest with the usual nodes, by a high order before."""
    finest = admittance(body(Nodes(80, 5)), [Disc(58.0, 10.0, 7.5)], [3.0], z_mm)
    coarse, usual = (
        np.abs(admittance(body(nodes), [Disc(58.0, 10.0, 7.5)], [3.0], z_mm) - finest).max()
        / np.abs(finest).max()
        for nodes in (Nodes(24), Nodes())
    )
    assert usual < 1e-11 and usual < 0.1 * coarse


@pytest.mark.parametrize("contrast", [0.0, 3.0, -0.9])
def test_agrees_with_boundary_integrals(contrast):
    fine = Resolution(rim=900, arc=30, digits=26.0, halvings=15)
    integrals = boundary.Body(Shape(R_MM), DEG, np.full(N, WIDTH_MM), 2.0, fine)
    mine, theirs = (
        admittance(skin, [Disc(58.0, 10.0, 7.5)], [contrast]) for skin in (body(), integrals)
    )
    assert np.abs(mine - theirs).max() < 1e-9 * np.abs(theirs).max()


def test_reciprocity_and_no_leak():
    matrix = admittance(body(), [Disc(58.0, 10.0, 7.5)], [3.0])
    assert np.abs(matrix - matrix.T).max() < 1e-12 * np.abs(matrix).max()
    assert np.abs(matrix.sum(axis=1)).max() < 1e-12 * np.abs(matrix).max()


def test_refuses_what_it_does_not_know():
    skin = body()
    with pytest.raises(ValueError, match="leaves the skin by 1"):
        skin.place([Disc(64.0, 0.0, 7.0)])
    with pytest.raises(ValueError, match="one inclusion"):
        skin.place([Disc(0.0, 0.0, 7.0), Disc(20.0, 0.0, 7.0)])
    with pytest.raises(ValueError, match="sharp"):
        leak = Radial.leaking(7.0, 0.0, 1e-3, 1.0)
        skin.place([Disc(0.0, 0.0, 7.0)]).admittance(skin.contact(np.ones(N)), [0.0], leak)
    with pytest.raises(ValueError, match="round rim"):
        disc.Body(Shape(R_MM, {2: 0.1}), DEG, np.full(N, WIDTH_MM))


@pytest.mark.parametrize("kind", ["null", "single:contact-area-growth"])
def test_a_case_is_the_boundarys(kind):
    mine, theirs = draw(kind, 3, 30, "disc"), draw(kind, 3, 30)
    assert mine.effects == theirs.effects and mine.states.equals(theirs.states)
    for a, b in ((mine.clean, theirs.clean), (mine.query_clean, theirs.query_clean)):
        assert 0.0 < np.abs(a - b).max() < 1e-6 * np.median(np.abs(theirs.clean[0]))

"""The witness's solver against analytic solutions, itself, finite elements and the tool's."""

import numpy as np
import pytest

from benchmark.finite_elements import FiniteElements
from eitskin.physics.forward import Forward, channel_values
from eitskin.physics.geometry import Geometry
from eitskin.physics.protocol import channel_table
from eitskin.physics.touch import Touch
from symmetric_mesh import symmetric_disc_mesh
from witness.arc import moment_response, segment_operator
from witness.boundary import Body, Disc, Radial, Resolution
from witness.curves import Shape

N, R_MM, WIDTH_MM, SHEET = 16, 70.0, 6.0, 1.5e-3
DEG = 22.5 * np.arange(N)
CHANNELS = channel_table(N)
LENGTH = np.full(N, 1.0 / R_MM)  # z sigma = 1 mm


def body(shape: Shape | None = None, clearance_mm: float = 4.0, **refined) -> Body:
    resolution = Resolution(**refined)
    return Body(shape or Shape(R_MM), DEG, np.full(N, WIDTH_MM), clearance_mm, resolution)


def volts(admittance: np.ndarray) -> np.ndarray:
    impedance = np.linalg.inv(0.5 * (admittance + admittance.T) + 1.0)
    return channel_values(impedance, CHANNELS)


def test_segment_log_of_a_constant():
    t, _, operator = segment_operator()
    exact = -((1 + t) * np.log(1 + t) + (1 - t) * np.log(1 - t) - 2) / np.pi
    assert np.abs(operator.sum(axis=1) - exact).max() < 1e-13


@pytest.mark.parametrize("beta", [0.01, 1.0])
def test_segment_converges(beta):
    coarse, fine = (moment_response(np.array([beta]), 14, h)[0] for h in (11, 15))
    assert np.abs(coarse - fine).max() < 2e-8 * np.abs(fine).max()


def test_concentric_disc_is_the_fourier_series():
    """A disc of conductivity k and radius a changes the rim's response to cos m theta from 1 / m
    to (1 + b) / (m (1 - b)), b = -(k - 1) / (k + 1) a^2m."""
    skin, a, contrast = body(), 0.4, 3.0
    place = skin.place([Disc(0.0, 0.0, a * R_MM)])
    among, from_moments, to_electrodes = place.fluxes
    system = among + (1.0 / contrast + 0.5) * np.eye(len(among))
    change = -to_electrodes @ np.linalg.solve(system, from_moments)
    m = np.arange(1, 60)
    b = -contrast / (contrast + 2.0) * a ** (2.0 * m)
    lag = skin.arc_angle[:, None] - skin.arc_angle
    series = np.cos(lag[..., None] * m) @ (((1 + b) / (1 - b) - 1) / (m * np.pi))
    assert np.abs(change - series).max() < 1e-11


def test_reciprocity_and_no_leak():
    shape = Shape(R_MM, {3: 0.03 * np.exp(0.5j)}, (1.2, 30.0), 0.2 * np.exp(1j))
    skin = body(shape)
    place = skin.place([Disc(20.0, 10.0, 7.5), Disc(-30.0, 15.0, 5.0)])
    admittance = place.admittance(skin.contact(LENGTH), [2.0, -0.5])
    scale = np.abs(admittance).max()
    assert np.abs(admittance - admittance.T).max() < 1e-9 * scale
    assert np.abs(admittance.sum(axis=1)).max() < 1e-9 * scale


def test_sixteenfold_symmetry():
    skin = body()
    admittance = skin.place([]).admittance(skin.contact(LENGTH), [])
    turned = np.roll(admittance, (1, 1), axis=(0, 1))
    assert np.abs(turned - admittance).max() < 1e-11 * np.abs(admittance).max()


def test_converged():
    """1e-6 of the median |v| untouched, 1e-4 of a touch's change, near the rim and across a
    patch."""
    discs = [Disc(55.0, 5.0, 7.5), Disc(48.0, 12.0, 8.0)]
    admittances = []
    for refined in ({}, {"rim": 900, "arc": 30, "digits": 26.0, "halvings": 15}):
        skin = body(Shape(R_MM, {2: 0.02}), 2.0, **refined)
        contact, place = skin.contact(0.3 * LENGTH), skin.place(discs)
        admittances.append(
            [volts(place.admittance(contact, c)) for c in ([0, 0], [3, 0], [3, -0.5])]
        )
    (plain, close, crossed), (plain_fine, near_fine, crossed_fine) = admittances
    assert np.abs(plain - plain_fine).max() < 1e-7 * np.median(np.abs(plain))
    for coarse, fine in ((close, near_fine), (crossed, crossed_fine)):
        change = np.abs(fine - plain_fine).max()
        assert np.abs((coarse - plain) - (fine - plain_fine)).max() < 1e-4 * change


@pytest.mark.parametrize(
    ("shape", "values"),
    [
        (Shape(R_MM), {}),
        (Shape(R_MM, {4: 0.02j}), {"shape_sin": {4: 0.02}}),
        (Shape(R_MM, {}, (1.3, 25.0)), {"anisotropy_ratio": 1.3, "anisotropy_deg": 25.0}),
    ],
)
def test_agrees_with_the_tool(shape, values):
    skin, disc = body(shape), Disc(50.0, 10.0, 7.5)
    contact, place = skin.contact(LENGTH), skin.place([disc])
    mine = [volts(SHEET * place.admittance(contact, [c])) for c in (0.0, 2.0)]
    tool = Forward(Geometry(R_MM, 3.0, 0.5, DEG, WIDTH_MM, 2e-3, **values))
    theirs = [
        channel_values(tool.transfer_impedance(touches), CHANNELS)
        for touches in ([], [Touch(disc.x_mm, disc.y_mm, disc.radius_mm, 2.0)])
    ]
    for a, b in zip(mine, theirs, strict=True):
        assert np.abs(a - b).max() < 1e-6 * np.median(np.abs(theirs[0]))


def test_tilt_agrees_with_finite_elements():
    across, angle, radius_mm, contrast = 0.3, 1.0, 20.0, 2.0
    mesh, rim = symmetric_disc_mesh(N, WIDTH_MM / R_MM, 1, 5, rings=(radius_mm / R_MM,))
    elements = FiniteElements(mesh, rim, contact=2e-3 / (3e-3 * R_MM * 1e-3), order=2)
    centre = mesh.p[:, mesh.t].mean(axis=1)
    tilt = 1.0 + 0.5 * across * (centre[0] * np.cos(angle) + centre[1] * np.sin(angle))
    inside = np.hypot(*centre) < radius_mm / R_MM
    skin = body(Shape(R_MM, tilt=across * np.exp(1j * angle)), 10.0)
    contact, place = skin.contact(LENGTH), skin.place([Disc(0.0, 0.0, radius_mm)])
    mine = [volts(SHEET * place.admittance(contact, [c])) for c in (0.0, contrast)]
    theirs = [
        channel_values(
            elements.transfer_impedance(SHEET * tilt * np.where(inside, 1 + c, 1.0)), CHANNELS
        )
        for c in (0.0, contrast)
    ]
    level = np.median(np.abs(theirs[0]))
    # Conductivity is constant in each element of the mesh: an error of second order in its size.
    assert np.abs(mine[0] - theirs[0]).max() < 2e-3 * level
    change = theirs[1] - theirs[0]
    assert np.abs(mine[1] - mine[0] - change).max() < 5e-4 * np.abs(change).max()


def test_layers_are_nested_discs():
    skin = body()
    contact = skin.contact(LENGTH)
    nested = skin.place([Disc(10.0, 20.0, 7.5), Disc(10.0, 20.0, 4.0)])
    sharp = nested.admittance(contact, [2.0, -0.5])
    layered = Radial.layered(np.array([4.0, 7.5]), np.array([1.5, 3.0]))
    single = skin.place([Disc(10.0, 20.0, 7.5)]).admittance(contact, [0.0], layered)
    assert np.abs(sharp - single).max() < 1e-12


def test_a_leak_takes_its_current():
    skin = body()
    place, contact = skin.place([Disc(10.0, 20.0, 7.5)]), skin.contact(LENGTH)
    sharp = place.admittance(contact, [2.0])
    none = place.admittance(contact, [0.0], Radial.leaking(7.5, 2.0, 1e-13, 1.0))
    assert np.abs(none - sharp).max() < 1e-9
    little = place.admittance(contact, [0.0], Radial.leaking(7.5, 2.0, 1e-6, 1.0))
    assert little.sum() == pytest.approx(1e-6, rel=1e-4)
    # Far in, a modified Bessel function falls off as exp(-kappa distance): flux = kappa potential.
    strong = Radial.leaking(1.0, 0.0, np.pi * 1e6, 1.0)
    assert strong.waves[0] == pytest.approx(1e3, rel=1e-3)


def test_refuses_what_leaves_the_skin():
    with pytest.raises(ValueError, match="leaves the skin by 1"):
        body().place([Disc(64.0, 0.0, 7.0)])

"""The witness's finite elements against analytic solutions, finer ones and boundary integrals."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csc_matrix
from skfem import Basis

from eitskin.errors import InputError
from eitskin.physics.forward import channel_values
from eitskin.physics.protocol import channel_table
from witness import boundary, elements
from witness.boundary import Disc, Radial
from witness.cases import draw, names_of
from witness.curves import Shape
from witness.elements import Fineness
from witness.generators import GENERATORS, LAWS
from witness.strengths import DRAWN

N, R_MM, WIDTH_MM = 16, 70.0, 6.0
DEG = 22.5 * np.arange(N)
CHANNELS = channel_table(N)
TOUCH = Disc(50.0, 10.0, 7.5)


def body(shape: Shape | None = None, fineness: Fineness | None = None) -> elements.Body:
    return elements.Body(shape or Shape(R_MM), DEG, np.full(N, WIDTH_MM), None, fineness)


def volts(skin, discs, contrasts, z_mm: float = 1.0, radial=None) -> np.ndarray:
    contact = skin.contact(np.full(N, z_mm / R_MM))
    admittance = skin.place(discs).admittance(contact, contrasts, radial)
    return channel_values(np.linalg.inv(0.5 * (admittance + admittance.T) + 1.0), CHANNELS)


def error(skin, reference, discs, contrasts, **settings) -> tuple[float, float]:
    """Largest difference over the median |v|, and of a touch over the touch."""
    mine, theirs = (
        [volts(s, [], [], settings.get("z_mm", 1.0)), volts(s, discs, contrasts, **settings)]
        for s in (skin, reference)
    )
    deviation = max(np.abs(a - b).max() for a, b in zip(mine, theirs, strict=True))
    touch = theirs[1] - theirs[0]
    of_touch = np.abs(mine[1] - mine[0] - touch).max() / np.abs(touch).max()
    return deviation / np.median(np.abs(theirs[0])), of_touch


def places(domain: elements.Domain) -> np.ndarray:
    """Complex places of the degrees of freedom."""
    x, y = Basis(domain.fem, domain.element, intorder=2).doflocs
    return x + 1j * y


def test_a_disc_draws_what_the_analytic_one_does():
    """int |grad r^m cos m phi|^2 over a disc is m pi."""
    place = body().place([TOUCH])
    _, edge, ((_, drawn),) = place.parts
    angle = np.angle(places(place.domain)[edge] - complex(TOUCH.x_mm, TOUCH.y_mm) / R_MM)
    for m in (1, 2, 5):
        wave = np.cos(m * angle)
        assert wave @ drawn @ wave == pytest.approx(m * np.pi, rel=1e-4)
    assert np.abs(drawn.sum(axis=1)).max() < 1e-9


def test_every_triangle_counts_once():
    """int |grad x|^2 is the area, pi (1 + a^2 / 2), whatever discs cross."""
    amplitude = 0.1
    place = body(Shape(R_MM, {3: amplitude})).place([Disc(20, 0, 7.5), Disc(10, 5, 10)])
    stiffness, _, drawn = place.parts
    x = places(place.domain).real
    assert x @ stiffness @ x == pytest.approx(np.pi * (1 + 0.5 * amplitude**2), rel=1e-5)
    assert {tuple(label) for label, _ in drawn} == {(True, False), (False, True), (True, True)}


def test_electrodes_are_as_long_as_they_are():
    place = body().place([TOUCH])
    for _, load in place.electrodes:
        assert load.sum() == pytest.approx(WIDTH_MM / R_MM, rel=1e-9)


def test_no_thin_triangles():
    mesh = body().place([Disc(62.0, 0.0, 4.0), Disc(55.0, 0.0, 6.0)]).domain.mesh
    a, b, c = mesh.place[mesh.corners].T
    sides = np.array([b - a, c - b, a - c])
    cosine = -(np.conj(sides) * np.roll(sides, 1, axis=0)).real
    cosine /= np.abs(sides) * np.abs(np.roll(sides, 1, axis=0))
    assert np.degrees(np.arccos(cosine.max())) > 8.0


def test_reciprocity_and_no_leak():
    skin = body(Shape(R_MM, {3: 0.03 * np.exp(0.5j)}, (1.2, 30.0), 0.2 * np.exp(1j)))
    place = skin.place([Disc(20.0, 10.0, 7.5), Disc(-30.0, 15.0, 5.0)])
    admittance = place.admittance(skin.contact(np.full(N, 1.0 / R_MM)), [2.0, -0.5])
    scale = np.abs(admittance).max()
    assert np.abs(admittance - admittance.T).max() < 1e-9 * scale
    assert np.abs(admittance.sum(axis=1)).max() < 1e-9 * scale


def finer(fineness):
    """All sides half as long, but under an electrode."""
    sides = ("end", "rim", "max_size", "circle", "crossing", "gap")
    return replace(fineness, **{side: 0.5 * getattr(fineness, side) for side in sides})


@pytest.mark.long
def test_converges_in_order():
    """Each order at least four times nearer to the finest."""
    finest = body(fineness=finer(Fineness()))
    errors = [
        error(body(fineness=Fineness(order)), finest, [TOUCH], [2.0])[0] for order in (2, 3, 4)
    ]
    assert errors[0] > 4.0 * errors[1] > 16.0 * errors[2]


@pytest.mark.long
def test_converges_in_size():
    """Quadratics: the potential's error falls as the third power, readings' as twice as many less
    what the sizes' slope, which stays, keeps."""
    finest = body(fineness=finer(Fineness()))
    coarse, fine = (
        error(body(fineness=fineness), finest, [TOUCH], [2.0])
        for fineness in (Fineness(2), finer(Fineness(2)))
    )
    assert fine[0] < coarse[0] / 4.0 and fine[1] < coarse[1] / 4.0


@pytest.mark.long
@pytest.mark.parametrize("z_mm", [0.02, 1.0])
def test_own_error(z_mm):
    """Under a third of the least noise that its cases have, and of a touch under 1e-3."""
    untouched_error, touch = error(
        body(), body(fineness=finer(Fineness())), [TOUCH], [2.0], z_mm=z_mm
    )
    assert untouched_error < GENERATORS["elements"].least_level / 3.0
    assert touch < 1e-3 / 3.0


@pytest.mark.parametrize(
    ("shape", "discs", "contrasts", "radial"),
    [
        (Shape(R_MM), [TOUCH], [2.0], None),
        (Shape(R_MM), [Disc(62.6, 0.0, 5.0)], [8.0], None),
        (Shape(R_MM, {5: 0.05 * np.exp(0.5j)}), [Disc(40.0, 10.0, 7.5)], [-0.9], None),
        (Shape(R_MM, {}, (1.5, 30.0)), [TOUCH], [2.0], None),
        (Shape(R_MM, tilt=0.5 * np.exp(1j)), [TOUCH], [2.0], None),
        (Shape(R_MM), [Disc(20.0, 0.0, 7.5), Disc(10.0, 5.0, 10.0)], [3.0, -0.5], None),
        (Shape(R_MM), [TOUCH], [2.0], Radial.leaking(7.5, 2.0, 1e-3, 1.0)),
        (Shape(R_MM), [TOUCH], [2.0], Radial.layered(np.array([4.0, 7.5]), np.array([3.0, 1.5]))),
    ],
)
def test_agrees_with_boundary_integrals(shape, discs, contrasts, radial):
    integrals = boundary.Body(shape, DEG, np.full(N, WIDTH_MM), 2.0)
    untouched_error, touch = error(body(shape), integrals, discs, contrasts, radial=radial)
    assert untouched_error < 1e-4 and touch < 2e-4


def test_refuses_what_leaves_the_skin():
    with pytest.raises(ValueError, match="leaves the skin by 1"):
        body().place([Disc(64.0, 0.0, 7.0)])


@pytest.mark.long
def test_a_case_is_the_boundarys():
    mine, theirs = draw("pair", 3, 30, "elements"), draw("pair", 3, 30)
    assert mine.effects == theirs.effects and mine.states.equals(theirs.states)
    for a, b in ((mine.clean, theirs.clean), (mine.query_clean, theirs.query_clean)):
        assert 0.0 < np.abs(a - b).max() < 1e-4 * np.median(np.abs(theirs.clean[0]))


def test_generators_say_what_they_do():
    kinds = [*(f"single:{name}" for name in DRAWN), *(f"outside:{law}" for law in LAWS)]
    for name, generator in GENERATORS.items():
        assert generator.unable <= set(DRAWN) | set(LAWS)
        assert generator.can("null") and generator.can("pair") and not generator.can("other")
        for kind in kinds:
            if generator.can(kind):
                names_of(kind, np.random.default_rng(0), name)
            else:
                with pytest.raises(InputError, match="generator"):
                    names_of(kind, np.random.default_rng(0), name)
        for seed in range(50):
            drawn, _ = names_of("triple", np.random.default_rng(seed), name)
            assert all(generator.does(effect) for effect in drawn)
    with pytest.raises(InputError, match="boundary"):
        draw("null", 1, generator="wrong")


@settings(max_examples=30, deadline=None)
@given(st.integers(2, 40), st.integers(1, 6), st.booleans(), st.integers(0, 2**31))
def test_what_ends_see_of_each_other_is_what_solving_for_each_gives(size, count, parts, seed):
    rng = np.random.default_rng(seed)
    root = np.where(rng.uniform(size=(size, size)) < 0.2, rng.standard_normal((size, size)), 0.0)
    if parts:
        root[: size // 2, size // 2 :] = root[size // 2 :, : size // 2] = 0.0
    matrix = root @ root.T + np.eye(size)
    rows = rng.permutation(size)[:count]
    ends = elements.units(size, rows).toarray()
    ends += 0.1 * rng.standard_normal(ends.shape) * (rng.uniform(size=ends.shape) < 0.5)
    response = elements.seen_from(csc_matrix(matrix), csc_matrix(ends))
    wanted = ends.T @ np.linalg.solve(matrix, ends)
    assert response == pytest.approx(wanted, rel=1e-8, abs=1e-8 * np.abs(wanted).max())

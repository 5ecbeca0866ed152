"""Finite elements against pyEIT, against themselves, and against closed forms."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import reference_disc as reference
from benchmark.finite_elements import FiniteElements, straight_mesh
from eitskin.errors import InputError
from eitskin.physics.protocol import channel_table
from symmetric_mesh import symmetric_disc_mesh

N = 16
CHANNELS = channel_table(N)


@pytest.fixture(scope="module")
def pyeit_mesh():
    wrapper = pytest.importorskip("pyeit.mesh.wrapper")
    return wrapper.create(N, h0=0.05)


@pytest.fixture(scope="module")
def pyeit_elements(pyeit_mesh):
    return FiniteElements(straight_mesh(pyeit_mesh.node, pyeit_mesh.element), pyeit_mesh.el_pos)


@pytest.fixture(scope="module")
def complete():
    mesh, facets = symmetric_disc_mesh(N, 0.1, 1, 2)
    return FiniteElements(mesh, facets, 0.05, order=2)


def orders(errors):
    """Orders of convergence between meshes of which each halves the one before."""
    return np.log2(np.array(errors[:-1]) / np.array(errors[1:]))


@pytest.mark.long
def test_voltages_equal_pyeit_for_every_touch_of_the_polar_grid(pyeit_mesh, pyeit_elements):
    from pyeit.eit import protocol
    from pyeit.eit.fem import EITForward
    from pyeit.mesh.wrapper import PyEITAnomaly_Circle, set_perm

    peer_protocol = protocol.create(N, dist_exc=1, step_meas=1, parser_meas="std")
    drives = np.repeat(peer_protocol.ex_mat, peer_protocol.n_meas, axis=0)
    channels = np.hstack([drives, peer_protocol.meas_mat.reshape(-1, 2)])
    assert np.array_equal(channels[:, [0, 1, 3, 2]], CHANNELS)
    peer = EITForward(pyeit_mesh, peer_protocol)

    forces = np.random.default_rng(0).uniform(0.0, 1.0, 192)
    touches = [(r, a) for r in np.linspace(0.1, 0.9, 8) for a in 2 * np.pi * np.arange(24) / 24]
    worst = 0.0
    for (r, a), force in zip(touches, forces, strict=True):
        touch = PyEITAnomaly_Circle(
            center=[r * np.cos(a), r * np.sin(a)], r=0.1, perm=1.0 + 9.0 * force
        )
        conductance = set_perm(pyeit_mesh, touch, background=1.0).perm
        assert (conductance != 1.0).any()
        expected = peer.solve_eit(conductance)
        voltages = pyeit_elements.voltages(conductance, channels, 1.0)
        worst = max(worst, np.max(abs(voltages - expected) / abs(expected)))
    assert worst < 1e-10


@settings(max_examples=25)
@given(
    st.floats(0.0, 0.9),
    st.floats(0.0, 2 * np.pi),
    st.floats(0.1, 0.3),
    st.sampled_from([-0.99, -0.5, 1e-6, 1.0, 9.0, 1e3]),
)
def test_touch_modes_equal_direct_solves(pyeit_elements, r, angle, radius, contrast):
    centroids = pyeit_elements.mesh.p[:, pyeit_elements.mesh.t].mean(axis=1)
    offset = centroids - np.array([[r * np.cos(angle)], [r * np.sin(angle)]])
    touched = np.hypot(*offset) < radius
    background = np.random.default_rng(1).uniform(0.5, 2.0, len(touched))
    factored = pyeit_elements.factored(background)
    modes = factored.touch_modes(np.flatnonzero(touched))
    direct = pyeit_elements.transfer_impedance(background * np.where(touched, 1.0 + contrast, 1.0))
    impedance = factored.transfer_impedance + modes.impedance_change([contrast])[0]
    # Both ways round each of the unknowns, in units of the stiffer part: the softer sees them as
    # many times larger as it is softer.
    unknowns, stiffer = pyeit_elements.mesh.nvertices, max(1.0 + contrast, 1.0 / (1.0 + contrast))
    rounding = unknowns * np.finfo(float).eps * stiffer
    assert np.max(abs(impedance - direct)) < rounding * np.max(abs(direct))


def test_touch_modes_hold_for_complete_electrodes_and_quadratic_elements(complete):
    middles = complete.mesh.p[:, complete.mesh.t].mean(axis=1)
    touched = np.hypot(middles[0] - 0.9, middles[1]) < 0.1
    factored = complete.factored(np.ones(complete.mesh.nelements))
    modes = factored.touch_modes(np.flatnonzero(touched))
    contrasts = np.array([-0.5, 0.3, 9.0])
    for contrast, change in zip(contrasts, modes.impedance_change(contrasts), strict=True):
        direct = complete.transfer_impedance(np.where(touched, 1.0 + contrast, 1.0))
        assert np.max(abs(factored.transfer_impedance + change - direct)) < 1e-10 * np.max(
            abs(direct)
        )


def test_touch_voltages_are_those_of_the_transfer_impedance(pyeit_elements):
    factored = pyeit_elements.factored(np.ones(pyeit_elements.mesh.nelements))
    modes = factored.touch_modes(np.arange(100, 140))
    contrasts = np.array([0.5, 4.0])
    expected = [
        0.003 * reference.voltages(change, CHANNELS) for change in modes.impedance_change(contrasts)
    ]
    voltages = 0.003 * modes.channel_change(CHANNELS, contrasts)
    assert np.max(abs(voltages - expected)) < 1e-13 * np.max(np.abs(expected))


def test_no_touched_element_changes_nothing(pyeit_elements):
    factored = pyeit_elements.factored(np.ones(pyeit_elements.mesh.nelements))
    assert not factored.touch_modes(np.array([], dtype=int)).impedance_change([9.0]).any()


@pytest.mark.parametrize("kind", ["points", "complete"])
def test_reciprocity_and_gauge(kind, pyeit_elements, complete):
    elements = pyeit_elements if kind == "points" else complete
    conductance = np.random.default_rng(2).uniform(0.2, 5.0, elements.mesh.nelements)
    impedance = elements.transfer_impedance(conductance)
    assert np.max(abs(impedance - impedance.T)) < 1e-12 * np.max(abs(impedance))
    assert np.max(abs(impedance.sum(axis=0))) < 1e-12
    assert np.max(abs(impedance.sum(axis=1))) < 1e-12
    assert np.linalg.eigvalsh(impedance)[1] > 0


@pytest.mark.parametrize("width", [0.0, 0.1])
@pytest.mark.parametrize("order", [1, 2])
def test_an_ideal_skin_is_circulant(width, order):
    mesh, electrodes = symmetric_disc_mesh(N, width, 1, 5)
    contact = 0.05 if width else None
    impedance = FiniteElements(mesh, electrodes, contact, order).transfer_impedance(
        np.ones(mesh.nelements)
    )
    for step in range(N):
        turned = np.roll(impedance, step, axis=(0, 1))
        assert np.max(abs(turned - impedance)) < 1e-10
    assert np.max(abs(impedance[::-1, ::-1] - impedance)) < 1e-10


def test_the_rim_and_the_rings_are_exact():
    mesh, electrodes = symmetric_disc_mesh(N, 0.1, 1, 3, rings=(0.35,))
    middles = mesh.dofs.facet_dofs[0]
    for facets in electrodes:
        ends = np.unwrap(np.sort(np.arctan2(*mesh.p[::-1, mesh.facets[:, facets]]).ravel()))
        assert np.ptp(ends) == pytest.approx(0.1, abs=1e-12)
    assert abs(np.hypot(*mesh.doflocs[:, middles[mesh.boundary_facets()]]) - 1).max() < 1e-15
    inside = np.hypot(*mesh.p[:, mesh.t].mean(axis=1)) < 0.35
    area = FiniteElements(mesh, electrodes, 1.0, 2).basis.dx[inside].sum()
    assert area == pytest.approx(np.pi * 0.35**2, rel=1e-6)


def smooth_errors(order, grading, refinements):
    """Against the closed form: points, concentric inclusion; worst channel over median |v|."""
    channels = channel_table(8)
    angles = 2 * np.pi * np.arange(8) / 8
    exact = reference.voltages(reference.points_concentric(angles, 0.4, 3.0), channels)
    errors = []
    for refinement in refinements:
        mesh, nodes = symmetric_disc_mesh(8, 0.0, refinement, grading, rings=(0.4,))
        inside = np.hypot(*mesh.p[:, mesh.t].mean(axis=1)) < 0.4
        elements = FiniteElements(mesh, nodes, order=order)
        voltages = elements.voltages(np.where(inside, 3.0, 1.0), channels, 1.0)
        errors.append(np.max(abs(voltages - exact)) / np.median(abs(exact)))
    return errors


def edge_errors(order, grading, refinements):
    """Against the Fourier series: complete electrodes; worst entry of R in ohm."""
    exact, doubt = reference.complete_electrodes(4, 0.6, 0.05, periods=200)
    assert doubt < 2e-8
    errors = []
    for refinement in refinements:
        mesh, facets = symmetric_disc_mesh(4, 0.6, refinement, grading)
        impedance = FiniteElements(mesh, facets, 0.05, order).transfer_impedance(
            np.ones(mesh.nelements)
        )
        errors.append(np.max(abs(impedance - exact)))
    return errors


@pytest.mark.long
def test_linear_elements_converge_with_order_two():
    errors = smooth_errors(1, 6, (1, 2, 3))
    assert errors[-1] < 2e-4
    assert 1.8 < orders(errors)[-1] < 2.1


@pytest.mark.long
def test_quadratic_elements_converge_with_order_four_where_graded_and_three_at_a_bare_point():
    graded = smooth_errors(2, 6, (1, 2, 3))
    assert graded[-1] < 1e-7
    assert 3.6 < orders(graded)[-1] < 4.1
    assert 2.8 < orders(smooth_errors(2, 0, (1, 2, 3)))[-1] < 3.1


@pytest.mark.long
def test_the_electrode_edge_costs_orders_on_an_ungraded_mesh():
    """The current ends in a jump: r log r in u, order 2 (with its logarithm) for any elements."""
    linear, quadratic = edge_errors(1, 0, (2, 3, 4)), edge_errors(2, 0, (2, 3, 4))
    assert 1.45 < orders(linear)[-1] < 1.8
    assert 1.75 < orders(quadratic)[-1] < 2.0
    assert quadratic[-1] > 1e-5


@pytest.mark.long
def test_grading_restores_the_orders_at_the_electrode_edge():
    linear, quadratic = edge_errors(1, 10, (0, 1, 2)), edge_errors(2, 10, (0, 1, 2))
    assert 1.9 < orders(linear)[-1] < 2.1
    assert 3.8 < orders(quadratic)[-1] < 4.1
    assert quadratic[-1] < 1e-7


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_a_conductance_that_is_none_is_refused(pyeit_elements, value):
    conductance = np.ones(pyeit_elements.mesh.nelements)
    conductance[7] = value
    with pytest.raises(InputError, match="conductance"):
        pyeit_elements.transfer_impedance(conductance)
    with pytest.raises(InputError, match="conductance"):
        pyeit_elements.transfer_impedance(conductance[1:])


def test_a_sliver_that_spoils_the_fields_is_refused():
    mesh, electrodes = symmetric_disc_mesh(N, 0.0, 1, 0)
    nodes, elements = mesh.p.T.copy(), mesh.t.T
    a, b, c = elements[np.flatnonzero((np.hypot(*mesh.p[:, mesh.t]) < 0.9).all(axis=0))[7]]
    nodes[a] = 0.3 * nodes[b] + 0.7 * nodes[c] + 1e-13
    sheet = FiniteElements(straight_mesh(nodes[: elements.max() + 1], elements), electrodes)
    with pytest.raises(InputError, match="slivers"):
        sheet.transfer_impedance(np.ones(len(elements)))


def test_electrodes_that_do_not_fit_are_refused(complete):
    mesh, facets = symmetric_disc_mesh(N, 0.1, 0, 0)
    inner = np.setdiff1d(np.arange(mesh.nfacets), mesh.boundary_facets())[:2]
    with pytest.raises(InputError, match=r"electrodes\[15\]"):
        FiniteElements(mesh, [*facets[:-1], inner], 0.05)
    with pytest.raises(InputError, match="contact"):
        FiniteElements(mesh, facets, 0.0)
    with pytest.raises(InputError, match="two nodes"):
        FiniteElements(mesh, np.array([3, 3]))
    with pytest.raises(InputError, match="order"):
        FiniteElements(mesh, facets, 0.05, order=3)
    with pytest.raises(InputError, match="overlap"):
        symmetric_disc_mesh(N, 0.4, 0, 0)
    with pytest.raises(InputError, match="rings"):
        symmetric_disc_mesh(N, 0.1, 0, 0, rings=(1.0,))

"""Leaks, broken and exchanged wires, against a network of resistors solved directly."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eitskin.effects.settings import settings, site_counts
from eitskin.errors import InputError
from eitskin.physics.forward import channel_values
from eitskin.physics.protocol import channel_table, reciprocal_channels
from eitskin.simulate.readings import apply_wiring

N = 16
CHANNELS = channel_table(N)
DRIVES = np.column_stack([np.arange(N), np.roll(np.arange(N), -1)])


def network(seed=0):
    """Conductance matrix of resistors between all electrodes, and its transfer impedance."""
    conductance = np.random.default_rng(seed).uniform(0.1e-3, 2e-3, (N, N))
    conductance = conductance + conductance.T
    matrix = np.diag(conductance.sum(axis=1)) - conductance
    return matrix, np.linalg.pinv(matrix)


MATRIX, IMPEDANCE = network()
CLEAN = np.swapaxes((IMPEDANCE[:, DRIVES[:, 0]] - IMPEDANCE[:, DRIVES[:, 1]])[None], 1, 2)


def potentials(*items, impedance=IMPEDANCE, sink_grounded=False):
    chosen = settings(list(items), site_counts(CHANNELS), (0, 0))
    return apply_wiring(impedance[None], chosen, DRIVES, sink_grounded)


def leak(electrodes, siemens):
    return {"name": "ground-leak", "electrodes": electrodes, "parameters": {"siemens": siemens}}


def readings(potential):
    """(M,) of potentials (1, D, n); the drive is named by its source."""
    source, _, plus, minus = CHANNELS.T
    return potential[0, source, plus] - potential[0, source, minus]


def against_first(potential):
    return potential - potential[:, :, :1]


def test_no_wiring_is_the_skin():
    assert np.allclose(readings(potentials()), channel_values(IMPEDANCE, CHANNELS))


@given(
    st.lists(st.integers(0, N - 1), min_size=1, max_size=5, unique=True),
    st.floats(1e-7, 1e-2),
    st.booleans(),
)
def test_leaks_against_the_network_with_its_ground(electrodes, siemens, grounded):
    admittance = siemens * (1 + np.arange(len(electrodes)))
    full = MATRIX.copy()
    full[electrodes, electrodes] += admittance
    expected = np.zeros((N, N))
    for d, (source, sink) in enumerate(DRIVES):
        current = np.zeros(N)
        current[source], current[sink] = 1.0, -1.0
        free = np.delete(np.arange(N), sink) if grounded else np.arange(N)
        expected[d, free] = np.linalg.solve(full[np.ix_(free, free)], current[free])
    found = potentials(leak(electrodes, admittance.tolist()), sink_grounded=grounded)
    assert np.allclose(against_first(found), against_first(expected[None]), atol=1e-6)


def test_leaks_of_two_entries_act_together():
    found = potentials(leak([2], 1e-3), leak([9], 2e-3))
    assert np.allclose(found, potentials(leak([2, 9], [1e-3, 2e-3])), rtol=0, atol=1e-12)


def test_one_leak_alone_carries_nothing_unless_the_sink_is_grounded():
    assert np.allclose(potentials(leak([5], 1e-3)), CLEAN, rtol=0, atol=1e-12)
    assert not np.allclose(potentials(leak([5], 1e-3), sink_grounded=True), CLEAN, atol=1e-3)


@given(st.floats(1e-7, 1e-2))
def test_a_source_against_ground_on_a_network_that_leaks_everywhere(siemens):
    full = MATRIX + siemens * np.eye(N)
    expected = np.zeros((N, N))
    for d, (source, sink) in enumerate(DRIVES):
        free = np.delete(np.arange(N), sink)
        expected[d, free] = np.linalg.solve(full[np.ix_(free, free)], np.eye(N)[source, free])
    found = potentials({"name": "ground-return", "parameters": {"siemens": siemens}})
    assert np.allclose(against_first(found), against_first(expected[None]), atol=1e-6)


def test_a_source_against_ground_is_as_if_floating_where_nothing_leaks():
    found = potentials({"name": "ground-return", "parameters": {"siemens": 1e-12}})
    assert np.allclose(readings(found), readings(CLEAN), rtol=0, atol=1e-6)


def test_against_ground_the_ends_of_a_source_are_told_apart():
    """A floating source's, exchanged, turn the sign of every reading and no more."""
    wires, leaky = DRIVES[:, ::-1], {"name": "ground-return", "parameters": {"siemens": 1e-4}}
    for item, alike in ((leak([2, 9], 1e-4), True), (leaky, False)):
        chosen = settings([item], site_counts(CHANNELS), (0, 0))
        turned = apply_wiring(IMPEDANCE[None], chosen, wires, False)
        assert np.allclose(readings(turned), -readings(potentials(item)), rtol=1e-6) == alike


def test_leaks_keep_reciprocity_under_a_floating_source():
    found = readings(potentials(leak([2, 9, 12], 1e-3)))
    pairs, sign = reciprocal_channels(CHANNELS)
    assert np.allclose(found[pairs[:, 0]], sign * found[pairs[:, 1]])
    grounded = readings(potentials(leak([2, 9, 12], 1e-3), sink_grounded=True))
    assert not np.allclose(grounded[pairs[:, 0]], sign * grounded[pairs[:, 1]], rtol=1e-3)


def test_point_electrodes_cannot_leak():
    impedance = IMPEDANCE.copy()
    np.fill_diagonal(impedance, np.nan)
    with pytest.raises(InputError, match="a width above 0"):
        potentials(leak([2, 9], 1e-3), impedance=impedance)


def swap(a, b):
    return {"name": "electrode-swap", "electrodes": [a, b]}


def test_swapped_wires_are_a_permuted_channel_table():
    wires = np.arange(N)
    wires[[3, 9]] = 9, 3
    found = readings(potentials(swap(3, 9)))
    assert np.allclose(found, channel_values(IMPEDANCE, wires[CHANNELS]))
    twice = potentials(swap(3, 9), swap(3, 9))
    assert np.allclose(twice, CLEAN)


def test_three_wires_in_turn():
    """The first swap of the list is the one next to the skin."""
    wires = np.arange(N)
    wires[[3, 9]] = 9, 3
    wires[[3, 4]] = wires[[4, 3]]
    found = readings(potentials(swap(3, 9), swap(3, 4)))
    assert np.allclose(found, channel_values(IMPEDANCE, wires[CHANNELS]))


def test_a_broken_wire():
    found = potentials({"name": "electrode-open", "electrodes": [4]})
    for d, drive in enumerate(DRIVES):
        if 4 in drive:
            assert not found[0, d].any()
        else:
            others = np.delete(CLEAN[0, d], 4)
            assert found[0, d, 4] == pytest.approx(others.mean())
            assert np.array_equal(np.delete(found[0, d], 4), others)


def test_a_broken_wire_of_a_point_electrode():
    impedance = IMPEDANCE.copy()
    np.fill_diagonal(impedance, np.nan)
    found = potentials({"name": "electrode-open", "electrodes": [4]}, impedance=impedance)
    undriven = np.delete(CLEAN[0, 8], [4, 8, 9])
    assert found[0, 8, 4] == pytest.approx(undriven.mean())
    assert np.isfinite(readings(found)).all()


def test_a_wire_both_broken_and_exchanged_is_named_by_its_electrode():
    """Electrode 4's wire is broken; it goes to the board's input 11."""
    broken = {"name": "electrode-open", "electrodes": [4]}
    found = potentials(swap(4, 11), broken)
    assert np.array_equal(found, potentials(broken, swap(4, 11)))
    assert not found[0, [10, 11]].any()
    assert found[0, 1, 11] == pytest.approx(np.delete(CLEAN[0, 1], 4).mean())
    assert found[0, 1, 4] == CLEAN[0, 1, 11]


def test_a_leak_is_at_its_electrode_whatever_its_wire():
    found = potentials(swap(4, 11), leak([4, 7], 1e-3))
    wires = np.arange(N)
    wires[[4, 11]] = 11, 4
    matrix = MATRIX.copy()
    matrix[[4, 7], [4, 7]] += 1e-3
    expected = channel_values(np.linalg.inv(matrix), wires[CHANNELS])
    assert np.allclose(readings(found), expected)

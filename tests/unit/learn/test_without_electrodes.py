"""The perceptron that does without electrodes: what it is shown while it is trained."""

import numpy as np
import pytest
import torch

from eitskin.exported.channels import Channels, precisions, strength_edges
from eitskin.exported.electrodes import channels_using
from eitskin.learn import without_electrodes
from eitskin.physics.protocol import channel_table

TABLE = channel_table(8)
COUNT = 400


@pytest.fixture(scope="module")
def shown():
    """Changes of rank three, their states, and what a network is given."""
    rng = np.random.default_rng(3)
    state = rng.normal(size=(COUNT, 3))
    change = state @ rng.normal(size=(3, len(TABLE))) + 0.01 * rng.normal(size=(COUNT, len(TABLE)))
    scale = change.std(axis=0)
    scalers = {
        "voltage_mean": np.zeros(len(TABLE)),
        "voltage_scale": scale,
        "state_mean": np.zeros(3),
        "state_scale": np.ones(3),
    }
    scalers = {key: torch.from_numpy(value) for key, value in scalers.items()}
    edges = strength_edges(change / scale)
    return change, state, Channels(precisions(change / scale, edges), edges), scalers


def lacking_of(shown, seed=1):
    change, _, channels, scalers = shown
    module = without_electrodes.Without(scalers, 8)
    z = change / scalers["voltage_scale"].numpy()
    return without_electrodes._DrawnSets(module, z, channels, TABLE, seed), z


def test_every_touch_lacks_a_set_of_its_own_and_others_in_the_next_epoch(shown):
    lacking, z = lacking_of(shown)
    rows = torch.arange(COUNT)
    batches = lacking(rows[: COUNT // 2]), lacking(rows[COUNT // 2 :])
    inputs = torch.cat(batches).numpy()
    lost = inputs[:, len(TABLE) :].astype(bool)
    assert set(lost.sum(axis=1)) == {1, 2}
    assert 0.5 < (lost.sum(axis=1) == 1).mean() < 0.7
    assert len(np.unique(lost, axis=0)) == len(without_electrodes.electrode_sets(8))
    for change, input_row, lost_indicator in zip(z, inputs, lost, strict=True):
        measured = ~channels_using(TABLE, np.flatnonzero(lost_indicator))
        assert np.allclose(input_row[: len(TABLE)][measured], change[measured], atol=1e-5)
        assert not np.allclose(input_row[: len(TABLE)][~measured], change[~measured], atol=1e-7)
    next_lost = lacking(rows).numpy()[:, len(TABLE) :].astype(bool)
    assert (next_lost != lost).any(axis=1).mean() > 0.8


def test_equal_seeds_train_equal_networks_that_do_without(shown):
    change, state, channels, scalers = shown
    trained = [
        without_electrodes.train((change, state), channels, TABLE, scalers, 12, seed)
        for seed in (1, 1, 2)
    ]
    weights = [torch.cat([p.flatten() for p in module.parameters()]) for module in trained]
    assert torch.equal(weights[0], weights[1]) and not torch.equal(weights[0], weights[2])
    scale = scalers["voltage_scale"].numpy()
    lost_indicator = np.zeros((COUNT, 8))
    lost_indicator[:, 5] = 1.0
    filled = (
        channels.filled_together(change / scale, np.flatnonzero(channels_using(TABLE, (5,))))
        * scale
    )
    estimated = trained[0](torch.from_numpy(np.hstack([filled, lost_indicator]))).numpy()
    assert np.sqrt(np.mean((estimated - state) ** 2)) < 0.3

from dataclasses import asdict

import numpy as np
import pytest
import torch
from sklearn.svm import SVR

from eitskin.errors import InputError
from eitskin.learn import networks
from eitskin.learn.models import MODELS, names
from eitskin.learn.networks import Shape, predictor
from eitskin.learn.networks.autoencoder_mlp import AutoencoderMlp
from eitskin.learn.networks.cnn import Cnn
from eitskin.learn.networks.convolutions import Halve
from eitskin.learn.networks.mlp import Mlp
from eitskin.learn.networks.svr import Svr
from eitskin.learn.networks.teachers import Autoencoder, StateToLatent
from eitskin.learn.networks.tokens import TokenEncoder, sinusoids
from eitskin.learn.networks.transformer import drive_tokens
from eitskin.learn.train import Tube
from eitskin.physics.protocol import channel_table

TABLE = channel_table(16).tolist()
SHAPE = Shape("a set", 208, 3, TABLE, 16)
NETWORKS = [name for name, model in MODELS.items() if not model.support_vectors]


def voltages(n, n_channels=208, seed=1):
    return torch.randn(n, n_channels, generator=torch.Generator().manual_seed(seed))


def evaluated(name, shape=SHAPE, seed=3):
    torch.manual_seed(seed)
    return predictor(name, shape).eval().requires_grad_(False)


def linear_widths(module):
    return [
        (layer.in_features, layer.out_features)
        for layer in module.modules()
        if isinstance(layer, torch.nn.Linear)
    ]


def test_networks_have_the_papers_widths():
    mlp = [(208, 256), (256, 128), (128, 64), (64, 3)]
    assert linear_widths(Mlp(208, 3)) == mlp
    autoencoder = Autoencoder(208, 16)
    assert linear_widths(autoencoder.encoder) == [(208, 256), (256, 64), (64, 16)]
    assert linear_widths(autoencoder.decoder) == [(16, 64), (64, 256), (256, 208)]
    assert linear_widths(StateToLatent(3, 16)) == [(3, 128), (128, 128), (128, 16)]
    latent_perceptron = AutoencoderMlp(208, 3, 16)
    assert linear_widths(latent_perceptron) == [
        (208, 256),
        (256, 64),
        (64, 16),
        (16, 256),
        *mlp[1:],
    ]
    cnn = Cnn(208, 3)
    blocks = [layer for layer in cnn.modules() if isinstance(layer, torch.nn.Conv1d)]
    assert [layer.out_channels for layer in blocks] == [64, 128, 256]
    assert {layer.kernel_size for layer in blocks} == {(3,)}
    assert linear_widths(cnn) == [(26 * 256, 128), (128, 64), (64, 3)]
    for name in ("transformer", "transformer-channels", "cnn-transformer"):
        modules = list(predictor(name, SHAPE).modules())
        encoders = [m for m in modules if isinstance(m, torch.nn.TransformerEncoderLayer)]
        assert [m.self_attn.num_heads for m in encoders] == [4, 4]
        assert [m.linear1.out_features for m in encoders] == [128, 128]


@pytest.mark.parametrize("name", NETWORKS)
@pytest.mark.parametrize(("electrodes", "n_targets"), [(16, 3), (8, 4)])
def test_states_are_linear_and_as_many_as_targets(name, electrodes, n_targets):
    table = channel_table(electrodes).tolist()
    shape = Shape("a set", len(table), n_targets, table, 16)
    module = evaluated(name, shape)
    assert module(voltages(5, len(table))).shape == (5, n_targets)
    assert isinstance(list(module.modules())[-1], torch.nn.Linear)


@pytest.mark.parametrize("name", NETWORKS)
def test_a_sample_does_not_depend_on_those_beside_it(name):
    module, batch = evaluated(name), voltages(300)
    batch[7, 4] = torch.nan
    together = networks.in_chunks(module, batch)
    assert together.isnan().any(dim=1).nonzero().tolist() == [[7]]
    torch.testing.assert_close(together[299:], module(batch[299:]), rtol=1e-4, atol=1e-5)


def test_physics_informed_is_a_way_to_train_any_network():
    for name in NETWORKS:
        assert type(predictor(f"physics-informed-{name}", SHAPE)) is type(predictor(name, SHAPE))


@pytest.mark.parametrize("name", ["gru", "physics-informed-svr", "autoencoder"])
def test_unknown_names_are_refused_with_those_known(name):
    with pytest.raises(InputError) as refused:
        predictor(name, SHAPE)
    message = f"models: name: found {name!r}, expected one of {', '.join(names())}"
    assert str(refused.value) == message


def test_a_shape_that_a_model_cannot_have_is_refused():
    bare = Shape("a set", 208, 3)
    with pytest.raises(InputError, match="a set: channels: found no table, expected a table of"):
        predictor("transformer", bare)
    with pytest.raises(InputError, match="found 208 in the table, expected a table of 200"):
        predictor("transformer", Shape("a set", 200, 3, TABLE))
    with pytest.raises(InputError, match="a set: autoencoder: found none"):
        predictor("autoencoder-mlp", bare)
    with pytest.raises(InputError, match="channels: found 7, expected 8 or more"):
        predictor("cnn", Shape("a set", 7, 3))
    with pytest.raises(InputError, match="channels: found 3, expected 4 or more"):
        predictor("cnn-transformer", Shape("a set", 3, 3))


def test_pooling_keeps_the_larger_of_two_neighbours():
    value = voltages(6).reshape(2, 3, 208)
    expected = torch.nn.functional.max_pool1d(value, 2)
    torch.testing.assert_close(Halve()(value), expected, rtol=0, atol=1e-6)
    odd = Halve()(value[..., :207])
    torch.testing.assert_close(odd, expected[..., :103], rtol=0, atol=1e-6)


def test_pooling_hands_the_gradient_to_the_larger_alone():
    value = voltages(6).reshape(2, 3, 208).requires_grad_()
    Halve()(value).sum().backward()
    a, b = value.detach().unflatten(-1, (-1, 2)).unbind(-1)
    expected = torch.stack([a >= b, a < b], dim=-1).flatten(-2).float()
    assert torch.equal(value.grad, expected)


def test_positions_are_sines_and_cosines_of_growing_wavelength():
    position = sinusoids(208, 64)
    for token, k in ((0, 0), (17, 5), (207, 31)):
        angle = token / 1e4 ** (2 * k / 64)
        expected = [np.sin(angle), np.cos(angle)]
        np.testing.assert_allclose(position[token, 2 * k : 2 * k + 2], expected, atol=1e-4)


def test_the_order_of_tokens_tells_only_by_their_positions():
    torch.manual_seed(1)
    encoder = TokenEncoder(16, 13).eval().requires_grad_(False)
    tokens = voltages(4).reshape(4, 16, 13)
    shuffled = tokens[:, torch.randperm(16)]
    assert (encoder(tokens) - encoder(shuffled)).abs().max() > 1e-2
    encoder.position.zero_()
    torch.testing.assert_close(encoder(tokens), encoder(shuffled), rtol=0, atol=1e-5)


def test_a_token_is_a_drive_and_a_slot_a_measuring_pair():
    tokens = drive_tokens(SHAPE)
    assert tokens.shape == (16, 16)
    table = np.array([*TABLE, [-1] * 4])[tokens]
    is_channel = tokens < 208
    assert sorted(tokens[is_channel].tolist()) == list(range(208))
    assert is_channel.sum(dim=1).tolist() == [13] * 16
    for drive in range(16):
        assert len(np.unique(table[drive, is_channel[drive], :2], axis=0)) == 1
        assert len(np.unique(table[is_channel[:, drive], drive, 2:], axis=0)) == 1


def test_a_channel_measured_twice_has_two_slots():
    table = [[0, 1, 2, 3], [0, 1, 3, 4], [0, 1, 2, 3], [1, 2, 3, 4]]
    tokens = drive_tokens(Shape("a set", 4, 3, table))
    assert tokens.tolist() == [[0, 2, 1], [4, 4, 3]]


@pytest.mark.parametrize("lost", [[0], [40, 41, 207]])
def test_a_lost_channel_is_an_empty_slot_that_contributes_nothing(lost):
    full_model = evaluated("transformer")
    measured = np.delete(np.arange(208), lost)
    table = np.array(TABLE)[measured].tolist()
    reduced_model = predictor("transformer", Shape("a set", len(measured), 3, table)).eval()
    reduced_model.load_state_dict(full_model.state_dict())
    batch = voltages(5)
    batch[:, lost] = 0
    torch.testing.assert_close(reduced_model(batch[:, measured]), full_model(batch))


def test_a_token_of_the_other_reading_is_a_channel():
    module = predictor("transformer-channels", Shape("a set", 40, 3))
    assert module.tokens.tolist() == [[k] for k in range(40)]


@pytest.mark.parametrize("name", NETWORKS)
def test_deterministic_algorithms_train_every_network(name, monkeypatch):
    def gradients():
        torch.manual_seed(1)
        module = predictor(name, SHAPE).train()
        module(voltages(16)).square().sum().backward()
        return {key: p.grad for key, p in module.named_parameters() if p.requires_grad}

    torch.use_deterministic_algorithms(True)
    first_gradients, repeated = gradients(), gradients()
    assert all(torch.equal(first_gradients[key], repeated[key]) for key in first_gradients)
    assert all(gradient.abs().sum() > 0 for gradient in first_gradients.values())


def test_the_encoder_of_the_autoencoder_mlp_is_not_trained():
    module = predictor("autoencoder-mlp", SHAPE)
    trained = {key.split(".")[0] for key, p in module.named_parameters() if p.requires_grad}
    assert trained == {"mlp"}


def test_support_vectors_are_scikit_learns():
    voltage, new = voltages(120, 20) * 1.3, voltages(50, 20, seed=2)
    state = torch.stack([voltage[:, :3].sum(1), voltage[:, 4].tanh(), voltage[:, 5] ** 2], dim=1)
    module = Svr(20, 3)
    module.fit(voltage, state, **asdict(Tube()))
    learned = [SVR().fit(voltage.double(), target) for target in state.double().T.numpy()]
    expected = np.column_stack([regression.predict(new.double()) for regression in learned])
    np.testing.assert_allclose(module(new), expected, atol=1e-5)
    assert len(module.support) == len(set().union(*(regression.support_ for regression in learned)))
    loaded = Svr(20, 3)
    loaded.load_state_dict(module.state_dict())
    assert torch.equal(loaded(new), module(new))

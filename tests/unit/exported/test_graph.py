"""What a network says, traced and applied with NumPy: the same numbers to rounding."""

import numpy as np
import pytest
import torch

from eitskin.errors import InputError
from eitskin.exported.graph import Graph, GraphFunction
from eitskin.learn import models, networks, trace
from eitskin.physics.protocol import channel_table

SHAPE = networks.Shape("waves", 208, 3, channel_table(16).tolist(), 16, (64, 32))
QUICK = ("svr", "mlp", "autoencoder-mlp")


def made(name):
    """A network with weights, and with statistics of a batch where it keeps them."""
    torch.manual_seed(1)
    module = networks.predictor(name, SHAPE)
    if models.model(name).support_vectors:
        numbers = {"support": torch.randn(30, 208), "dual": torch.randn(3, 30).double()}
        numbers |= {"intercept": torch.randn(3).double(), "gamma": torch.tensor(0.002).double()}
        module.load_state_dict(numbers)
    module.train()(torch.randn(40, 208))
    return module.eval().requires_grad_(False)


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=[] if n in QUICK else pytest.mark.long) for n in models.MODELS],
)
def test_every_model_of_the_table_is_the_same(name):
    module, frames = made(name), torch.randn(5, 208)
    graph, arrays = trace.traced(module, frames, "net/")
    applied = GraphFunction(Graph.from_json(graph.as_json()), arrays)
    for inputs in (frames, frames[:1]):
        expected = module(inputs).numpy()
        (outputs,) = applied(inputs.numpy())
        assert outputs.dtype == expected.dtype
        np.testing.assert_allclose(outputs, expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max())


class Odd(torch.nn.Module):
    def forward(self, frames):
        return torch.erfinv(frames)


def test_an_operation_that_is_not_known_is_refused():
    with pytest.raises(InputError, match=r"found aten\.erfinv\.default, expected operations"):
        trace.traced(Odd(), torch.zeros(2, 3), "")

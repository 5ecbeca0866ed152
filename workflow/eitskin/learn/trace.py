"""PyTorch modules traced to graphs that need no PyTorch."""

import operator

import numpy as np
import torch
from torch import Tensor, nn
from torch.export import Dim, ExportedProgram

from eitskin.errors import InputError
from eitskin.exported.graph import Graph, Step

ASSERTIONS = ("aten._assert_tensor_metadata.default",)  # without effect on the results


def traced(module: nn.Module, example: Tensor, prefix: str) -> tuple[Graph, dict[str, np.ndarray]]:
    """The graph of `module` and its arrays, with names that begin with `prefix`. It takes any
    number of frames like `example` (B, ...), a single one where B is 1.

    Raises InputError for operations that `exported.graph` does not have.
    """
    fastpath_enabled = torch.backends.mha.get_fastpath_enabled()
    torch.backends.mha.set_fastpath_enabled(False)  # one kernel, which shows no operation
    try:
        with torch.no_grad():
            dynamic = ({0: Dim("frames", min=1)},) if len(example) > 1 else None
            program = torch.export.export(module.eval(), (example,), dynamic_shapes=dynamic)
    finally:
        torch.backends.mha.set_fastpath_enabled(fastpath_enabled)
    return _graph(program, prefix)


def _graph(program: ExportedProgram, prefix: str) -> tuple[Graph, dict[str, np.ndarray]]:
    signature = program.graph_signature
    array_names = {
        **signature.inputs_to_parameters,
        **signature.inputs_to_buffers,
        **signature.inputs_to_lifted_tensor_constants,
    }
    values = {**program.constants, **program.state_dict}
    arrays = {}
    references: dict[str, dict[str, str]] = {}
    input_names, steps, outputs = [], [], []
    for node in program.graph.nodes:
        if node.op == "placeholder" and node.name in array_names:
            key = f"{prefix}{array_names[node.name]}"
            arrays[key] = values[array_names[node.name]].detach().cpu().numpy()
            references[node.name] = {"array": key}
        elif node.op == "placeholder":
            input_names.append(node.name)
            references[node.name] = {"step": node.name}
        elif node.op == "output":
            outputs = [argument.name for argument in node.args[0]]
        elif _name(node.target) not in ASSERTIONS:
            arguments = [_plain(argument, references) for argument in node.args]
            named = {key: _plain(argument, references) for key, argument in node.kwargs.items()}
            steps.append(Step(node.name, _name(node.target), arguments, named))
            references[node.name] = {"step": node.name}
    graph = Graph(input_names[0], steps, outputs)
    if unknown := graph.unknown_operations():
        expected = "operations of eitskin.exported.graph"
        raise InputError("export", "operations", ", ".join(unknown), expected)
    return graph, arrays


def _name(target: object) -> str:
    """An operation's name."""
    if target in (operator.getitem, operator.mul):
        return target.__name__
    return str(target)


def _plain(argument: object, references: dict[str, dict[str, str]]) -> object:
    """An argument as a value of JSON, as in `exported.graph.Graph`."""
    if isinstance(argument, torch.fx.Node):
        return references[argument.name]
    if isinstance(argument, list | tuple):
        return [_plain(element, references) for element in argument]
    if isinstance(argument, torch.dtype):
        return {"dtype": str(argument).removeprefix("torch.")}
    return argument

"""PyTorch modules as graphs that need no PyTorch."""

import operator

import numpy as np
import torch
from torch import Tensor, nn
from torch.export import Dim, ExportedProgram

from eitskin.errors import InputError
from eitskin.exported.graph import Graph, Step

LEFT_OUT = ("aten._assert_tensor_metadata.default",)  # checks that change nothing


def traced(module: nn.Module, example: Tensor, prefix: str) -> tuple[Graph, dict[str, np.ndarray]]:
    """The graph of `module` for any number of frames like `example` (B, ...), for one alone where
    B is 1, and its arrays, their names beginning with `prefix`.

    Raises InputError where the module has operations that `exported.graph` does not know.
    """
    before = torch.backends.mha.get_fastpath_enabled()
    torch.backends.mha.set_fastpath_enabled(False)  # one kernel, which shows no operation
    try:
        with torch.no_grad():
            dynamic = ({0: Dim("frames", min=1)},) if len(example) > 1 else None
            program = torch.export.export(module.eval(), (example,), dynamic_shapes=dynamic)
    finally:
        torch.backends.mha.set_fastpath_enabled(before)
    return _graph(program, prefix)


def _graph(program: ExportedProgram, prefix: str) -> tuple[Graph, dict[str, np.ndarray]]:
    signature = program.graph_signature
    held = {
        **signature.inputs_to_parameters,
        **signature.inputs_to_buffers,
        **signature.inputs_to_lifted_tensor_constants,
    }
    values = {**program.constants, **program.state_dict}
    arrays = {}
    references: dict[str, dict[str, str]] = {}
    given, steps, outputs = [], [], []
    for node in program.graph.nodes:
        if node.op == "placeholder" and node.name in held:
            key = f"{prefix}{held[node.name]}"
            arrays[key] = values[held[node.name]].detach().cpu().numpy()
            references[node.name] = {"array": key}
        elif node.op == "placeholder":
            given.append(node.name)
            references[node.name] = {"step": node.name}
        elif node.op == "output":
            outputs = [one.name for one in node.args[0]]
        elif _name(node.target) not in LEFT_OUT:
            arguments = [_plain(one, references) for one in node.args]
            named = {key: _plain(one, references) for key, one in node.kwargs.items()}
            steps.append(Step(node.name, _name(node.target), arguments, named))
            references[node.name] = {"step": node.name}
    graph = Graph(given[0], steps, outputs)
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
    """An argument as a graph has it."""
    if isinstance(argument, torch.fx.Node):
        return references[argument.name]
    if isinstance(argument, list | tuple):
        return [_plain(one, references) for one in argument]
    if isinstance(argument, torch.dtype):
        return {"dtype": str(argument).removeprefix("torch.")}
    return argument

"""A network's operations as traced by PyTorch, applied with NumPy.

A graph is data: its steps are ATen operations by name, in order, and their arguments are numbers,
lists, names of earlier steps and names of arrays. It holds no code, so that applying a stranger's
file is as safe as reading it. Only the operations in `OPERATIONS` can be applied.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from eitskin.exported.channels import nan_mean

Array = np.ndarray


def _linear(x: Array, weight: Array, bias: Array | None = None) -> Array:
    return x @ weight.T if bias is None else x @ weight.T + bias


def _conv1d(
    x: Array,
    weight: Array,
    bias: Array | None = None,
    stride: tuple = (1,),
    padding: tuple = (0,),
    dilation: tuple = (1,),
    groups: int = 1,
) -> Array:
    """(B, C, L) → (B, O, L'), of stride, dilation and groups 1."""
    assert (*stride, *dilation, groups) == (1, 1, 1)
    frames, _, length = x.shape
    wide = np.zeros((frames, x.shape[1], length + 2 * padding[0]), x.dtype)
    wide[:, :, padding[0] : padding[0] + length] = x
    windows = sliding_window_view(wide, weight.shape[2], axis=2)  # (B, C, L', k)
    columns = windows.transpose(0, 1, 3, 2).reshape(frames, -1, windows.shape[2])
    convolved = weight.reshape(len(weight), -1) @ columns
    return convolved if bias is None else convolved + bias[:, None]


def _batch_norm(
    x: Array,
    weight: Array,
    bias: Array,
    mean: Array,
    variance: Array,
    training: bool,
    momentum: float,
    epsilon: float,
    *_: object,
) -> Array:
    assert not training
    slope = weight / np.sqrt(variance + np.float32(epsilon))
    return x * slope[:, None] + (bias - mean * slope)[:, None]


def _layer_norm(
    x: Array, shape: list, weight: Array, bias: Array, epsilon: float, *_: object
) -> Array:
    assert len(shape) == 1
    centred = x - x.mean(axis=-1, keepdims=True)
    variance = np.square(centred).mean(axis=-1, keepdims=True)
    return centred / np.sqrt(variance + np.float32(epsilon)) * weight + bias


def _attention(query: Array, key: Array, value: Array, *options: object) -> Array:
    assert not any(options)  # no mask, no dropout, not causal
    score = query @ np.swapaxes(key, -1, -2) * np.float32(query.shape[-1] ** -0.5)
    score -= score.max(axis=-1, keepdims=True)
    np.exp(score, out=score)
    return (score @ value) / score.sum(axis=-1, keepdims=True)


def _pad(x: Array, pads: list, mode: str = "constant", value: float | None = None) -> Array:
    assert mode == "constant" and len(pads) == 2
    return np.pad(x, [(0, 0)] * (x.ndim - 1) + [tuple(pads)], constant_values=value or 0)


def _index(x: Array, indices: list) -> Array:
    return x[tuple(slice(None) if index is None else index for index in indices)]


def _unflatten(x: Array, axis: int, sizes: list) -> Array:
    axis %= x.ndim
    return x.reshape(*x.shape[:axis], *sizes, *x.shape[axis + 1 :])


def _flatten(x: Array, start: int = 0, end: int = -1) -> Array:
    end %= x.ndim
    return x.reshape(*x.shape[:start], -1, *x.shape[end + 1 :])


def _unbind(x: Array, axis: int = 0) -> list[Array]:
    return list(np.moveaxis(x, axis, 0))


def _slice(
    x: Array, axis: int = 0, start: int | None = None, end: int | None = None, step: int = 1
) -> Array:
    return x[(slice(None),) * (axis % x.ndim) + (slice(start, end, step),)]


def _select(x: Array, axis: int, index: int) -> Array:
    return np.take(x, index, axis)


def _tensor_split(x: Array, places: list, axis: int = 0) -> list[Array]:
    return np.split(x, [place % x.shape[axis] for place in places], axis)


def _split(x: Array, size: int, axis: int = 0) -> list[Array]:
    return np.split(x, range(size, x.shape[axis], size), axis)


def _cast(x: Array, dtype: np.dtype, *_: object) -> Array:
    return x.astype(dtype, copy=False)


def _mean(x: Array, axes: list | None = None, keep: bool = False) -> Array:
    return x.mean(axis=None if axes is None else tuple(axes), keepdims=keep)


def _sum(x: Array, axes: list, keep: bool = False) -> Array:
    return x.sum(axis=tuple(axes), keepdims=keep)


def _nanmean(x: Array, axes: list, keep: bool = False) -> Array:
    return nan_mean(x, tuple(axes), keep)


def _minimum(x: Array, axis: int, keep: bool = False) -> tuple[Array, None]:
    return x.min(axis=axis, keepdims=keep), None  # no network uses the indices


def _distances(x: Array, references: Array, *_: object) -> Array:
    """(B, R): Euclidean, of (B, K) to (R, K)."""
    return np.sqrt(np.square(x[:, None] - references).sum(axis=-1))


def _identity(x: Array, *_: object, **__: object) -> Array:
    return x


OPERATIONS: dict[str, Callable] = {
    "aten.linear.default": _linear,
    "aten.conv1d.default": _conv1d,
    "aten.batch_norm.default": _batch_norm,
    "aten.layer_norm.default": _layer_norm,
    "aten.scaled_dot_product_attention.default": _attention,
    "aten.pad.default": _pad,
    "aten.index.Tensor": _index,
    "aten.unflatten.int": _unflatten,
    "aten.flatten.using_ints": _flatten,
    "aten.unbind.int": _unbind,
    "aten.select.int": _select,
    "aten.slice.Tensor": _slice,
    "aten.tensor_split.indices": _tensor_split,
    "aten.split.Tensor": _split,
    "aten.to.dtype": _cast,
    "aten.mean.dim": _mean,
    "aten.mean.default": _mean,
    "aten.sum.dim_IntList": _sum,
    "aten.nanmean.default": _nanmean,
    "aten.min.dim": _minimum,
    "aten.cdist.default": _distances,
    "aten.dropout.default": _identity,
    "aten.alias.default": _identity,
    "aten.contiguous.default": _identity,
    "aten.relu.default": lambda x: np.maximum(x, 0),
    "aten.add.Tensor": np.add,
    "aten.sub.Tensor": np.subtract,
    "aten.mul.Tensor": np.multiply,
    "aten.div.Tensor": np.divide,
    "aten.neg.default": np.negative,
    "aten.exp.default": np.exp,
    "aten.square.default": np.square,
    "aten.sqrt.default": np.sqrt,
    "aten.matmul.default": np.matmul,
    "aten.rsub.Scalar": lambda x, constant: constant - x,
    "aten.unsqueeze.default": np.expand_dims,
    "aten.squeeze.dim": lambda x, axis: np.squeeze(x, axis) if x.shape[axis] == 1 else x,
    "aten.transpose.int": np.swapaxes,
    "aten.permute.default": np.transpose,
    "aten.numpy_T.default": np.transpose,
    "aten.mT.default": lambda x: np.swapaxes(x, -1, -2),
    "aten.view.default": lambda x, sizes: x.reshape(sizes),
    "aten.reshape.default": lambda x, sizes: x.reshape(sizes),
    "aten.cat.default": lambda arrays, axis=0: np.concatenate(arrays, axis),
    "aten.stack.default": lambda arrays, axis=0: np.stack(arrays, axis),
    "aten.sym_size.int": lambda x, axis: x.shape[axis],
    "getitem": lambda values, index: values[index],
    "mul": lambda a, b: a * b,
}


@dataclass(frozen=True)
class Step:
    """One operation: the name of its result, the operation's name, and its arguments."""

    name: str
    operation: str
    arguments: list
    keywords: dict


@dataclass(frozen=True)
class Graph:
    """Steps applied to frames named `input`; `outputs` names the steps whose results are returned.

    An argument is a value of JSON, {"step": name}, {"array": name}, {"dtype": name}, or a list of
    these.
    """

    input: str
    steps: list[Step]
    outputs: list[str]

    def unknown_operations(self) -> list[str]:
        """The operations that are not in OPERATIONS, sorted."""
        return sorted({step.operation for step in self.steps} - OPERATIONS.keys())

    def as_json(self) -> dict:
        """The graph as values of JSON."""
        steps = [[step.name, step.operation, step.arguments, step.keywords] for step in self.steps]
        return {"input": self.input, "steps": steps, "outputs": self.outputs}

    @classmethod
    def from_json(cls, plain: dict) -> "Graph":
        """The graph of such values; raises KeyError, TypeError or ValueError for another form."""
        steps = [Step(*step) for step in plain["steps"]]
        return cls(plain["input"], steps, list(plain["outputs"]))


class GraphFunction:
    """A graph with its arrays as a function of frames; steps that depend on arrays alone are
    evaluated once."""

    def __init__(self, graph: Graph, arrays: dict[str, Array]):
        """Raises KeyError for an unknown operation, step or array."""
        slots = {graph.input: 0}
        self._constants: dict[int, Any] = {}
        self._steps: list[tuple[Callable, int]] = []
        for step in graph.steps:
            function, slot = OPERATIONS[step.operation], len(slots)
            positional = [self._getter(argument, slots, arrays) for argument in step.arguments]
            named = {
                key: self._getter(argument, slots, arrays)
                for key, argument in step.keywords.items()
            }
            slots[step.name] = slot
            run = _call(function, positional, named)
            if all(fixed for _, fixed in (*positional, *named.values())):
                self._constants[slot] = run({})
            else:
                self._steps.append((run, slot))
        self._outputs = [slots[name] for name in graph.outputs]

    def _getter(
        self, argument: Any, slots: dict[str, int], arrays: dict[str, Array]
    ) -> tuple[Any, bool]:
        """An argument and True where it is constant; otherwise the function that takes it from the
        values of the steps, and False."""
        if isinstance(argument, list):
            parts = [self._getter(element, slots, arrays) for element in argument]
            if all(fixed for _, fixed in parts):
                return [value for value, _ in parts], True
            return (lambda values: [v if fixed else v(values) for v, fixed in parts]), False
        if isinstance(argument, dict):
            ((kind, name),) = argument.items()
            if kind == "array":
                return arrays[name], True
            if kind == "dtype":
                return np.dtype(name), True
            slot = slots[name]
            if slot in self._constants:
                return self._constants[slot], True
            return (lambda values: values[slot]), False
        return argument, True

    def __call__(self, frames: Array) -> tuple[Any, ...]:
        """The graph's outputs for frames (B, ...)."""
        values = {0: frames, **self._constants}
        for run, slot in self._steps:
            values[slot] = run(values)
        return tuple(values[slot] for slot in self._outputs)


def _call(
    function: Callable, positional: list[tuple[Any, bool]], named: dict[str, tuple[Any, bool]]
) -> Callable:
    """`function` of its arguments, as a function of the values of the steps."""

    def run(values: dict[int, Any]) -> Any:
        return function(
            *[argument if fixed else argument(values) for argument, fixed in positional],
            **{
                key: argument if fixed else argument(values)
                for key, (argument, fixed) in named.items()
            },
        )

    return run

"""Operators that a model may contain, and the shape of what each one makes.

Operators and attributes outside the table are refused, as are operators whose output size depends on data.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from palpate.core import CertificateError

Shape = tuple[int, ...]
MAX_RANK = 5
TREES_DOMAIN = "ai.onnx.ml"


def refuse(code: str, why: str) -> CertificateError:
    """Return the error of a model that is not admitted."""
    return CertificateError(why, code=f"onnx-{code}")


@dataclass(frozen=True, slots=True)
class Call:
    """Node with all that determines its output's shape; a shape is () for an omitted input."""

    kind: str
    shapes: tuple[Shape, ...]
    attributes: Mapping[str, Any]
    constants: tuple[np.ndarray | None, ...]
    outputs: int

    def constant(self, position: int) -> np.ndarray:
        """Values of an input that must be constant because a shape depends on it."""
        values = self.constants[position]
        if values is None:
            raise refuse("shape", f"the shape that {self.kind} makes depends on data, not on a constant")
        return values

    def whole(self, position: int) -> tuple[int, ...]:
        values = self.constant(position)
        if values.size > MAX_RANK:
            raise refuse("shape", f"{self.kind} takes {values.size} numbers where {MAX_RANK} at most fit")
        return tuple(values.tolist())

    def axis(self, default: int, rank: int) -> int:
        axis = int(self.attributes.get("axis", default))
        if not -rank <= axis < rank:
            raise refuse("shape", f"{self.kind} has the axis {axis} on a tensor of rank {rank}")
        return axis % rank

    def of_rank(self, rank: int) -> Shape:
        """Shape of the first input, which must have this rank."""
        if len(self.shapes[0]) != rank:
            raise refuse("shape", f"{self.kind} takes a tensor of rank {rank}, got {list(self.shapes[0])}")
        return self.shapes[0]


# shapes of the outputs, and the multiply-adds or comparisons that the node takes
Inferred = tuple[list[Shape], int]
Infer = Callable[[Call], Inferred]


def size_of(shape: Sequence[int]) -> int:
    """Return the number of elements."""
    return math.prod(shape)


def broadcast(kind: str, shapes: Sequence[Shape]) -> Shape:
    """Return the shape of an elementwise operator's result (NumPy's rule)."""
    rank = max(len(shape) for shape in shapes)
    padded = [(1,) * (rank - len(shape)) + shape for shape in shapes]
    made = []
    for sizes in zip(*padded, strict=True):
        wide = {size for size in sizes if size != 1}
        if len(wide) > 1:
            raise refuse("shape", f"{kind} joins shapes that do not fit: {[list(s) for s in shapes]}")
        made.append(wide.pop() if wide else 1)
    return tuple(made)


def _elementwise(call: Call) -> Inferred:
    made = broadcast(call.kind, call.shapes)
    return [made], size_of(made) * len(call.shapes)


def _first(call: Call) -> Inferred:
    """The first input's shape; further inputs are per-channel numbers."""
    if any(len(shape) > 1 for shape in call.shapes[1:]):
        raise refuse("shape", f"{call.kind} takes one number or a row of numbers for each parameter")
    return [call.shapes[0]], size_of(call.shapes[0])


def _softmax(call: Call) -> Inferred:
    call.axis(-1, len(call.shapes[0]))
    return _first(call)


def _flatten(call: Call) -> Inferred:
    shape = call.shapes[0]
    if not shape or call.attributes.get("axis", 1) != 1:
        raise refuse("shape", "Flatten takes a tensor of rank 1 or more, and keeps its first axis")
    return [(shape[0], size_of(shape[1:]))], 0


def _reshape(call: Call) -> Inferred:
    shape, wanted = call.shapes[0], list(call.whole(1))
    if len(wanted) > MAX_RANK or wanted.count(-1) > 1 or min(wanted, default=0) < -1:
        raise refuse("shape", f"Reshape to {wanted}")
    for i, size in enumerate(wanted):
        if size == 0:
            if i >= len(shape):
                raise refuse("shape", f"Reshape of {list(shape)} to {wanted}")
            wanted[i] = shape[i]
    if -1 in wanted:
        known = size_of([size for size in wanted if size != -1])
        if not known or size_of(shape) % known:
            raise refuse("shape", f"Reshape of {list(shape)} to {wanted}")
        wanted[wanted.index(-1)] = size_of(shape) // known
    if size_of(wanted) != size_of(shape):
        raise refuse("shape", f"Reshape of {list(shape)} to {wanted}")
    return [tuple(wanted)], 0


def _transpose(call: Call) -> Inferred:
    shape = call.shapes[0]
    order = [int(i) for i in call.attributes.get("perm", range(len(shape))[::-1])]
    if sorted(order) != list(range(len(shape))):
        raise refuse("shape", f"Transpose of {list(shape)} by {order}")
    return [tuple(shape[i] for i in order)], size_of(shape)


def _concat(call: Call) -> Inferred:
    rank = len(call.shapes[0])
    axis = call.axis(0, rank)
    others = {shape[:axis] + shape[axis + 1 :] for shape in call.shapes}
    if len(others) > 1 or any(len(shape) != rank for shape in call.shapes):
        raise refuse("shape", f"Concat joins shapes that do not fit: {[list(s) for s in call.shapes]}")
    made = list(call.shapes[0])
    made[axis] = sum(shape[axis] for shape in call.shapes)
    return [tuple(made)], size_of(made)


def _gather(call: Call) -> Inferred:
    shape, picked = call.shapes
    indices, axis = call.constant(1), call.axis(0, len(shape))
    if indices.size and not -shape[axis] <= indices.min() <= indices.max() < shape[axis]:
        raise refuse("shape", f"Gather takes an index beyond an axis of {shape[axis]}")
    made = (*shape[:axis], *picked, *shape[axis + 1 :])
    return [made], size_of(made)


def _slice(call: Call) -> Inferred:
    shape = list(call.shapes[0])
    starts, ends, axes = call.whole(1), call.whole(2), call.whole(3)
    if len({len(starts), len(ends), len(axes)}) > 1 or len(call.shapes) != 4:
        raise refuse("shape", "Slice takes starts, ends, and axes of one length, and no steps")
    for first, end, axis in zip(starts, ends, axes, strict=True):
        if not 0 <= axis < len(shape) or not 0 <= first <= end:
            raise refuse("shape", f"Slice of {shape} from {first} to {end} along axis {axis}")
        shape[axis] = max(0, min(end, shape[axis]) - first)
    return [tuple(shape)], size_of(shape)


def _reduce(call: Call) -> Inferred:
    shape, axes, kept = call.shapes[0], call.whole(1), call.attributes.get("keepdims", 1)
    if not axes or not all(-len(shape) <= axis < len(shape) for axis in axes) or kept not in (0, 1):
        raise refuse("shape", f"{call.kind} of {list(shape)} over {list(axes)}, keepdims {kept!s:.20}")
    reduced = {axis % len(shape) for axis in axes}
    made = [1 if axis in reduced else size for axis, size in enumerate(shape) if kept or axis not in reduced]
    return [tuple(made)], size_of(shape)


def _top_k(call: Call) -> Inferred:
    shape, count = list(call.shapes[0]), call.whole(1)
    axis = call.axis(-1, len(shape))
    if len(count) != 1 or not 0 <= count[0] <= shape[axis]:
        raise refuse("shape", f"TopK of {list(count)} along an axis of {shape[axis]}")
    work = size_of(shape) * max(1, shape[axis].bit_length())
    shape[axis] = count[0]
    return [tuple(shape)] * 2, work


def _matmul(call: Call) -> Inferred:
    left, right = call.shapes
    if min(len(left), len(right)) < 2 or left[-1] != right[-2]:
        raise refuse("shape", f"MatMul of {list(left)} and {list(right)}")
    made = (*broadcast("MatMul", (left[:-2], right[:-2])), left[-2], right[-1])
    return [made], size_of(made) * left[-1]


def _gemm(call: Call) -> Inferred:
    left, right = call.shapes[:2]
    if len(left) != 2 or len(right) != 2:
        raise refuse("shape", f"Gemm of {list(left)} and {list(right)}")
    right = right[::-1] if call.attributes.get("transB") else right
    made = (left[0], right[1])
    if left[1] != right[0] or (len(call.shapes) > 2 and broadcast("Gemm", (made, call.shapes[2])) != made):
        raise refuse("shape", f"Gemm of {[list(s) for s in call.shapes]}")
    return [made], size_of(made) * left[1]


def _window(call: Call, kernel: Sequence[int]) -> tuple[int, int]:
    """Height and width of the result of a sliding window."""
    height, width = call.of_rank(4)[2:]
    pads = [int(v) for v in call.attributes.get("pads", (0, 0, 0, 0))]
    strides = [int(v) for v in call.attributes.get("strides", (1, 1))]
    fits = len(pads) == 4 and len(strides) == 2 and min(strides) >= 1 and min(kernel) >= 1
    if not fits or not all(0 <= pad < kernel[i % 2] for i, pad in enumerate(pads)):
        raise refuse("shape", f"{call.kind} with a window of {list(kernel)}, pads {pads}, strides {strides}")
    tall = (height + pads[0] + pads[2] - kernel[0]) // strides[0] + 1
    wide = (width + pads[1] + pads[3] - kernel[1]) // strides[1] + 1
    if min(tall, wide) < 1:
        raise refuse("shape", f"{call.kind} with a window of {list(kernel)} over an image {height} x {width}")
    return tall, wide


def _conv(call: Call) -> Inferred:
    count, channels = call.of_rank(4)[:2]
    weights, groups = call.shapes[1], int(call.attributes.get("group", 1))
    if len(weights) != 4 or groups < 1 or weights[0] % groups or weights[1] * groups != channels:
        raise refuse("shape", f"Conv of {list(call.shapes[0])} with {list(weights)} in {groups} groups")
    if len(call.shapes) > 2 and call.shapes[2] != weights[:1]:
        raise refuse("shape", f"Conv of {weights[0]} features with a bias of {list(call.shapes[2])}")
    made = (count, weights[0], *_window(call, weights[2:]))
    return [made], size_of(made) * size_of(weights[1:])


def _max_pool(call: Call) -> Inferred:
    kernel = [int(v) for v in call.attributes.get("kernel_shape", ())]
    if len(kernel) != 2 or call.outputs != 1:
        raise refuse("shape", f"MaxPool with a window of {kernel}")
    made = (*call.of_rank(4)[:2], *_window(call, kernel))
    return [made], size_of(made) * size_of(kernel)


def _global_pool(call: Call) -> Inferred:
    shape = call.of_rank(4)
    return [(*shape[:2], 1, 1)], size_of(shape)


def _trees(call: Call) -> Inferred:
    made = (call.of_rank(2)[0], int(call.attributes["n_targets"]))
    nodes = len(call.attributes["nodes_treeids"])
    return [made], made[0] * (nodes + len(call.attributes["target_ids"]))


@dataclass(frozen=True, slots=True)
class AdmittedOperator:
    """Shape inference of an admitted operator, limits of its number of inputs, and its attributes."""

    infer: Infer
    inputs: tuple[int, int]
    attributes: frozenset[str] = frozenset()


def _operator(infer: Infer, least: int, most: int, attributes: str = "") -> AdmittedOperator:
    return AdmittedOperator(infer, (least, most), frozenset(attributes.split()))


MANY = 1000
_WINDOWS = "pads strides auto_pad"
# attributes that a node may state with their default value only
FIXED: Mapping[str, object] = {
    "allowzero": 0, "alpha": 1.0, "auto_pad": b"NOTSET", "beta": 1.0, "ceil_mode": 0, "storage_order": 0,
    "transA": 0,
}  # fmt: skip
_TREES = """
    n_targets aggregate_function post_transform nodes_treeids nodes_nodeids nodes_featureids nodes_values
    nodes_truenodeids nodes_falsenodeids nodes_modes target_treeids target_nodeids target_ids target_weights
"""
# operators by (domain, name) of models and corrections, and ReduceMean for users
OPERATORS: Mapping[tuple[str, str], AdmittedOperator] = {
    ("", "Abs"): _operator(_elementwise, 1, 1),
    ("", "Add"): _operator(_elementwise, 2, 2),
    ("", "BatchNormalization"): _operator(_first, 5, 5, "epsilon"),
    ("", "Cast"): _operator(_elementwise, 1, 1, "to"),
    ("", "Concat"): _operator(_concat, 1, MANY, "axis"),
    ("", "Conv"): _operator(_conv, 2, 3, f"group {_WINDOWS}"),
    ("", "DequantizeLinear"): _operator(_first, 3, 3, "axis"),
    ("", "Div"): _operator(_elementwise, 2, 2),
    ("", "Exp"): _operator(_elementwise, 1, 1),
    ("", "Flatten"): _operator(_flatten, 1, 1, "axis"),
    ("", "Gather"): _operator(_gather, 2, 2, "axis"),
    ("", "Gemm"): _operator(_gemm, 2, 3, "transA transB alpha beta"),
    ("", "GlobalAveragePool"): _operator(_global_pool, 1, 1),
    ("", "Log"): _operator(_elementwise, 1, 1),
    ("", "MatMul"): _operator(_matmul, 2, 2),
    ("", "Max"): _operator(_elementwise, 1, MANY),
    ("", "MaxPool"): _operator(_max_pool, 1, 1, f"kernel_shape ceil_mode storage_order {_WINDOWS}"),
    ("", "Mean"): _operator(_elementwise, 1, MANY),
    ("", "Min"): _operator(_elementwise, 1, MANY),
    ("", "Mul"): _operator(_elementwise, 2, 2),
    ("", "Neg"): _operator(_elementwise, 1, 1),
    ("", "QuantizeLinear"): _operator(_first, 3, 3, "axis"),
    ("", "ReduceMean"): _operator(_reduce, 2, 2, "keepdims"),
    ("", "ReduceSum"): _operator(_reduce, 2, 2, "keepdims"),
    ("", "Relu"): _operator(_elementwise, 1, 1),
    ("", "Reshape"): _operator(_reshape, 2, 2, "allowzero"),
    ("", "Slice"): _operator(_slice, 4, 4),
    ("", "Softmax"): _operator(_softmax, 1, 1, "axis"),
    ("", "Sqrt"): _operator(_elementwise, 1, 1),
    ("", "Sub"): _operator(_elementwise, 2, 2),
    ("", "TopK"): _operator(_top_k, 2, 2, "axis"),
    ("", "Transpose"): _operator(_transpose, 1, 1, "perm"),
    (TREES_DOMAIN, "TreeEnsembleRegressor"): _operator(_trees, 1, 1, _TREES),
}

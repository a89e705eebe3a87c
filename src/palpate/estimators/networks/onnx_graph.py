"""Small ONNX graphs, grown a node at a time and checked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np
import onnx
from numpy.typing import ArrayLike
from onnx import TensorProto, helper, numpy_helper

OPSET = 18
# The newest IR that the oldest onnxruntime allowed by the dependencies reads.
IR_VERSION = 9

Weights = Mapping[str, np.ndarray]
EMPTY: Weights = MappingProxyType({})


class OnnxGraph:
    """A graph that begins at the node `image`; every method adds to it and names what it has made."""

    def __init__(self) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.constants: dict[str, np.ndarray] = {}

    def add(
        self, kind: str, inputs: Sequence[str], weights: Weights = EMPTY, *, output: str = "", **how: object
    ) -> str:
        """Add a node, whose weights follow its inputs; returns the name of what it makes."""
        names = {f"{name}{len(self.nodes)}": value for name, value in weights.items()}
        self.constants |= names
        name = output or f"x{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, [*inputs, *names], [name], **how))
        return name

    def centred(self, at: str, level: ArrayLike, contrast: ArrayLike) -> str:
        """(x - level) / contrast, each one number or one a feature."""
        at = self.add("Sub", [at], {"level": _row(level)})
        return self.add("Div", [at], {"contrast": _row(contrast)})

    def restored(self, at: str, scale: ArrayLike, mean: ArrayLike, output: str = "") -> str:
        """Scale and shift, x scale + mean, each one number or one a feature."""
        at = self.add("Mul", [at], {"scale": _row(scale)})
        return self.add("Add", [at], {"mean": _row(mean)}, output=output)

    def model(self, shape: tuple[int, int, int], targets: int) -> onnx.ModelProto:
        """All of it as a model from ``image [n c h w]`` to ``value [n t]``; a node must be named `value`."""
        return image_to_value(self.nodes, self.constants, shape, targets)


def _row(values: ArrayLike) -> np.ndarray:
    return np.asarray(values, np.float32)[None]


def image_to_value(
    nodes: Sequence[onnx.NodeProto],
    constants: Weights,
    shape: tuple[int, int, int],
    targets: int,
) -> onnx.ModelProto:
    """A model from ``image [n c h w]`` to ``value [n t]``.

    Args:
        nodes: the graph's nodes, in order.
        constants: its weights, by name.
        shape: (c, h, w).
        targets: t.
    """
    graph = helper.make_graph(
        list(nodes),
        "palpate",
        [helper.make_tensor_value_info("image", TensorProto.FLOAT, ["n", *shape])],
        [helper.make_tensor_value_info("value", TensorProto.FLOAT, ["n", targets])],
        [numpy_helper.from_array(np.ascontiguousarray(v), k) for k, v in constants.items()],
    )
    model = helper.make_model(
        graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION, producer_name="palpate"
    )
    onnx.checker.check_model(model, full_check=True)
    return model

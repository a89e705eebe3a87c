"""Small ONNX graphs, built and checked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

OPSET = 18
# The newest IR that the oldest onnxruntime allowed by the dependencies reads.
IR_VERSION = 9


def image_to_value(
    nodes: Sequence[onnx.NodeProto],
    constants: Mapping[str, np.ndarray],
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

"""A network's convolutions in whole numbers of eight bits.

Activations and weights are rounded to 8 bits with a scale for each tensor, for weights one for each output
channel (Jacob et al., CVPR 2018, doi:10.1109/CVPR.2018.00286). The scales of activations are set by images.

Only convolutions are rounded, with their rectifiers and the sums of residual blocks. Those that see the image
itself, and the dense layers, stay in float32: they take little time, and rounding them costs the most.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import onnx
from onnxruntime.quantization import CalibrationDataReader, QuantFormat, QuantType, quantize_static
from onnxruntime.quantization.shape_inference import quant_pre_process

from palpate.core.errors import InputError
from palpate.core.shapes import Tensor

ROUNDED = ("Conv", "Relu", "Add")


def int8_model(model: Path, seen: Iterator[Tensor], work: Path) -> onnx.ModelProto:
    """A model in int8, self-contained and of standard operators alone.

    Args:
        model: one from `image` to `value`, in float32.
        seen: inputs to set the scales of activations by.
        work: a folder for passing files.

    Raises:
        InputError: it has no convolution to round.
    """
    fused, rounded = work / "fused.onnx", work / "int8.onnx"
    # Normalisation goes into the convolutions before them. Shapes are told apart without symbols, which would
    # need another package.
    quant_pre_process(str(model), str(fused), skip_symbolic_shape=True)
    plain = onnx.load(str(fused))
    for i, node in enumerate(plain.graph.node):
        node.name = f"{node.op_type}{i}"
    chosen = nodes_to_round(plain.graph)
    if not any(name.startswith("Conv") for name in chosen):
        raise InputError(
            f"{model} has no convolution behind those that see the image, so that int8 would gain nothing; "
            "keep it as it is"
        )
    onnx.save(plain, str(fused))
    quantize_static(
        str(fused),
        str(rounded),
        _Images(seen),
        quant_format=QuantFormat.QDQ,
        op_types_to_quantize=list(ROUNDED),
        nodes_to_quantize=chosen,
        per_channel=True,
        # With weights of 7 bits a sum of two products fits 16: the numbers are the same without VNNI.
        reduce_range=True,
        activation_type=QuantType.QUInt8,
        weight_type=QuantType.QInt8,
    )
    return _tidied(onnx.load(str(rounded)))


def nodes_to_round(graph: onnx.GraphProto) -> list[str]:
    """Names of the convolutions behind the first ones, their rectifiers, and the sums of residual blocks."""
    constants = {tensor.name for tensor in graph.initializer}
    behind: set[str] = set()  # what a convolution has made, or something that had it from one
    chosen = []
    for node in graph.node:
        deep = not behind.isdisjoint(node.input)
        # A sum with a constant is the last step, into the targets' units: it must not be rounded.
        shift = node.op_type == "Add" and not constants.isdisjoint(node.input)
        if deep and node.op_type in ROUNDED and not shift:
            chosen.append(node.name)
        if deep or node.op_type == "Conv":
            behind.update(node.output)
    return chosen


def _tidied(model: onnx.ModelProto) -> onnx.ModelProto:
    """Without the families of operators that the runtime declares and no node uses."""
    used = {node.domain for node in model.graph.node}
    kept = [family for family in model.opset_import if family.domain in used]
    del model.opset_import[:]
    model.opset_import.extend(kept)
    onnx.checker.check_model(model, full_check=True)
    return model


class _Images(CalibrationDataReader):  # type: ignore[misc]  # onnxruntime is seen as Any
    """Inputs as the runtime asks for them."""

    def __init__(self, seen: Iterator[Tensor]) -> None:
        self.seen = seen

    def get_next(self) -> dict[str, Tensor] | None:
        inputs = next(self.seen, None)
        return None if inputs is None else {"image": inputs}

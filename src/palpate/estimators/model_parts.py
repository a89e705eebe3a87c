"""The few parts of an ONNX model that are looked at before it is run, read without the onnx package.

Sensing needs to know one thing of a model's bytes: that they hold all of it. The messages below are those of
ONNX with only the fields that say so; protobuf skips the others. Field numbers are those of onnx.proto, which
never change (https://github.com/onnx/onnx/blob/main/onnx/onnx.proto).
"""

from __future__ import annotations

from functools import cache
from typing import Any

from google.protobuf.descriptor_pb2 import DescriptorProto, FieldDescriptorProto, FileDescriptorProto
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass

from palpate.core import CertificateError

EXTERNAL = 1  # of TensorProto.DataLocation

MESSAGES: dict[str, tuple[tuple[str, int, str], ...]] = {
    "Model": (("graph", 7, "Graph"),),
    "Graph": (("node", 1, "*Node"), ("initializer", 5, "*Tensor")),
    "Node": (("attribute", 5, "*Attribute"),),
    "Attribute": (("t", 5, "Tensor"), ("g", 6, "Graph"), ("graphs", 11, "*Graph")),
    "Tensor": (("external_data", 13, "*Entry"), ("data_location", 14, "")),
    "Entry": (),
}
"""Name, number and type of each field: a message, ``*`` for a repeated one, nothing for an integer."""


def refuse_other_files(model: bytes, source: str) -> None:
    """Refuse a model that keeps weights or constants in another file, or has graphs inside its graph.

    Args:
        model: the bytes of an ONNX file.
        source: what they came from, for the message.

    Raises:
        CertificateError: it does.
        google.protobuf.message.DecodeError: the bytes are no ONNX file.
    """
    graph = _model_class().FromString(model).graph
    if any(_is_external(tensor) for tensor in graph.initializer):
        raise CertificateError(f"{source} keeps weights in another file, which is refused; export it whole")
    for attribute in (one for node in graph.node for one in node.attribute):
        if _is_external(attribute.t):
            raise CertificateError(f"{source} keeps constants in another file, which is refused")
        if attribute.HasField("g") or attribute.graphs:
            raise CertificateError(f"{source} has graphs inside its graph, which palpate never writes")


def _is_external(tensor: Any) -> bool:
    return tensor.data_location == EXTERNAL or bool(tensor.external_data)


@cache
def _model_class() -> Any:
    """The class of the message `Model`, made from `MESSAGES`."""
    file = FileDescriptorProto(
        name="palpate/model_parts.proto",
        package="palpate",
        syntax="proto2",
        message_type=[
            DescriptorProto(name=name, field=[_field(*field) for field in fields])
            for name, fields in MESSAGES.items()
        ],
    )
    pool = DescriptorPool()
    pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName("palpate.Model"))


def _field(name: str, number: int, kind: str) -> FieldDescriptorProto:
    F = FieldDescriptorProto
    label = F.LABEL_REPEATED if kind.startswith("*") else F.LABEL_OPTIONAL
    message = kind.removeprefix("*")
    if not message:
        return F(name=name, number=number, label=label, type=F.TYPE_INT32)
    return F(name=name, number=number, label=label, type=F.TYPE_MESSAGE, type_name=f".palpate.{message}")

"""Messages of an ONNX file, as far as its admission inspects them, without the onnx package.

Sensing does not load the onnx package, whose import takes longer than all else that a reading needs. The
messages are those of ONNX with the fields that decide about admission; protobuf skips the others. Field
numbers are those of onnx.proto, which never change (https://github.com/onnx/onnx/blob/main/onnx/onnx.proto).
"""

from __future__ import annotations

from functools import cache
from typing import Any

from google.protobuf.descriptor_pb2 import DescriptorProto, FieldDescriptorProto, FileDescriptorProto
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass

F = FieldDescriptorProto
SCALARS = {
    "int": F.TYPE_INT64,
    "float": F.TYPE_FLOAT,
    "double": F.TYPE_DOUBLE,
    "string": F.TYPE_STRING,
    "bytes": F.TYPE_BYTES,
}

MESSAGES: dict[str, tuple[tuple[str, int, str], ...]] = {
    "Model": (
        ("ir_version", 1, "int"), ("opset_import", 8, "*OperatorSet"), ("graph", 7, "Graph"),
        ("training_info", 20, "*Opaque"), ("functions", 25, "*Opaque"),
    ),
    "OperatorSet": (("domain", 1, "string"), ("version", 2, "int")),
    "Graph": (
        ("node", 1, "*Node"), ("initializer", 5, "*Tensor"), ("sparse_initializer", 15, "*Opaque"),
        ("input", 11, "*Value"), ("output", 12, "*Value"),
    ),
    "Node": (
        ("input", 1, "*string"), ("output", 2, "*string"), ("op_type", 4, "string"),
        ("domain", 7, "string"), ("overload", 8, "string"), ("attribute", 5, "*Attribute"),
    ),
    "Attribute": (
        ("name", 1, "string"), ("ref_attr_name", 21, "string"), ("type", 20, "int"), ("f", 2, "float"),
        ("i", 3, "int"), ("s", 4, "bytes"), ("t", 5, "Tensor"), ("g", 6, "Opaque"),
        ("sparse_tensor", 22, "Opaque"), ("tp", 14, "Opaque"), ("floats", 7, "*float"), ("ints", 8, "*int"),
        ("strings", 9, "*bytes"), ("tensors", 10, "*Tensor"), ("graphs", 11, "*Opaque"),
        ("sparse_tensors", 23, "*Opaque"), ("type_protos", 15, "*Opaque"),
    ),
    "Tensor": (
        ("dims", 1, "*int"), ("data_type", 2, "int"), ("segment", 3, "Opaque"), ("float_data", 4, "*float"),
        ("int32_data", 5, "*int"), ("string_data", 6, "*bytes"), ("int64_data", 7, "*int"),
        ("name", 8, "string"), ("raw_data", 9, "bytes"), ("double_data", 10, "*double"),
        ("uint64_data", 11, "*int"), ("external_data", 13, "*Opaque"), ("data_location", 14, "int"),
    ),
    "Value": (("name", 1, "string"), ("type", 2, "Type")),
    "Type": (("tensor_type", 1, "TensorType"),),
    "TensorType": (("elem_type", 1, "int"), ("shape", 2, "Shape")),
    "Shape": (("dim", 1, "*Dimension"),),
    "Dimension": (("dim_value", 1, "int"), ("dim_param", 2, "string")),
    "Opaque": (),
}  # fmt: skip
"""Name, number, and type of each field; * marks a repeated one. Opaque stands for what is refused."""


def parse_model(model: bytes) -> Any:
    """Parse the bytes of an ONNX file into the message `Model`.

    Raises:
        google.protobuf.message.DecodeError: the bytes are no ONNX file.
    """
    return _model_class().FromString(model)


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
    label = F.LABEL_REPEATED if kind.startswith("*") else F.LABEL_OPTIONAL
    kind = kind.removeprefix("*")
    if kind in SCALARS:
        return F(name=name, number=number, label=label, type=SCALARS[kind])
    return F(name=name, number=number, label=label, type=F.TYPE_MESSAGE, type_name=f".palpate.{kind}")

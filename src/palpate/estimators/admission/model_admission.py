"""Decide from the bytes of an ONNX model whether a runtime may load it.

An untrusted file of 1 kB can request 25 GB. A model is admitted if its nodes are in `operators.OPERATORS`, it
has no subgraphs, functions, sparse or external constants, every constant is finite and complete, every shape
follows from the input's, and its size is within the limits of this module. Messages are parsed without the
onnx package, whose import is slow, by the field numbers of
https://github.com/onnx/onnx/blob/main/onnx/onnx.proto.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cache
from typing import Any

import numpy as np
from google.protobuf.descriptor_pb2 import DescriptorProto, FieldDescriptorProto, FileDescriptorProto
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass

from palpate.core import CertificateError
from palpate.estimators.admission.operators import (
    FIXED,
    MAX_RANK,
    OPERATORS,
    TREES_DOMAIN,
    Call,
    Shape,
    refuse,
    size_of,
)

F = FieldDescriptorProto
SCALARS = {
    "int": F.TYPE_INT64,
    "float": F.TYPE_FLOAT,
    "double": F.TYPE_DOUBLE,
    "string": F.TYPE_STRING,
    "bytes": F.TYPE_BYTES,
}

# name, number, and type of each field; * marks a repeated one; Opaque is refused
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


def parse_model(model: bytes) -> Any:
    """Parse the bytes of an ONNX file into the message `Model`."""
    return _model_class().FromString(model)


@cache
def _model_class() -> Any:
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


MAX_PARAMETER_BYTES = 256 << 20  # two ResNet-18 have 90 MB
MAX_TENSOR_BYTES = 512 << 20  # of all tensors together that are made from one image
MAX_WORK = 50_000_000_000  # multiply-adds for one image; two ResNet-18 at 224 px take 3.6e9
MAX_NODES = 2000  # two ResNet-18 have about 140
MAX_TREE_DEPTH = 128
IR_VERSIONS = range(8, 12)
OPSETS: Mapping[str, int] = {"": 18, TREES_DOMAIN: 3}
BYTES_PER_ELEMENT = 8
BATCHES = (2, 3)  # sizes of batch for which shapes are inferred; what does not scale with them is refused
TYPES: dict[int, np.dtype[Any]] = {
    1: np.dtype("<f4"), 2: np.dtype("u1"), 3: np.dtype("i1"), 6: np.dtype("<i4"), 7: np.dtype("<i8"),
    9: np.dtype("?"), 11: np.dtype("<f8"),
}  # fmt: skip
_LISTS = dict.fromkeys(TYPES, "int32_data") | {1: "float_data", 7: "int64_data", 11: "double_data"}
_VALUES = {1: "f", 2: "i", 3: "s", 6: "floats", 7: "ints", 8: "strings"}  # by AttributeProto.type
FLOAT = 1


def admit_model(model: bytes, source: str, image: tuple[int, int, int], outputs: int) -> None:
    """Refuse a model that a runtime must not load.

    Args:
        model: Bytes of an ONNX file.
        source: Name of the origin, for the message.
        image: Channels, height, and width of the input ``image [n c h w]``.
        outputs: Width of the output ``value [n o]``.
    """
    try:
        _admit(model, image, outputs)
    except CertificateError as e:
        raise CertificateError(
            f"{source} is not a model that is run: {e}. Use a model that `palpate calibrate` wrote.",
            code=e.code,
        ) from e
    except Exception as e:  # protobuf raises many kinds of its own
        raise CertificateError(
            f"{source} is not a model that can be run ({type(e).__name__}). Restore it or calibrate again.",
            code="onnx-damaged",
        ) from e


def _admit(model: bytes, image: tuple[int, int, int], outputs: int) -> None:
    if len(model) > MAX_PARAMETER_BYTES + (16 << 20):
        raise refuse("parameters", f"it has {len(model)} bytes")
    found = parse_model(model)
    graph = found.graph
    if found.functions or found.training_info:
        raise refuse("function", "it has functions or training steps")
    _check_versions(found)
    if len(graph.node) > MAX_NODES:
        raise refuse("nodes", f"it has {len(graph.node)} nodes, and {MAX_NODES} is the limit")
    for node in graph.node:
        _check_node(node)
    constants = _constants(graph)
    _check_interface(graph, image, outputs)
    shapes = [_shapes(graph, constants, (batch, *image)) for batch in BATCHES]
    _check_batches(shapes)
    if shapes[0].get("value") != (BATCHES[0], outputs):
        raise refuse("interface", f"it makes {shapes[0].get('value')}, not {outputs} values for each image")


def _check_versions(model: Any) -> None:
    versions = [(one.domain, one.version) for one in model.opset_import]
    for domain, version in versions:
        if domain not in OPSETS:
            raise refuse("domain", f"it has operators of {domain[:60]!r}")
        if version != OPSETS[domain]:
            raise refuse("opset", f"it is of opset {version} of {domain or 'ONNX'}")
    if not versions or len(dict(versions)) < len(versions) or model.ir_version not in IR_VERSIONS:
        raise refuse("opset", f"it states no opset, states one twice, or is of IR version {model.ir_version}")


def _check_node(node: Any) -> None:
    for attribute in node.attribute:
        if attribute.HasField("g") or attribute.graphs:
            raise refuse("subgraph", f"it has graphs inside its graph, in {node.op_type[:60]!r}")
        if attribute.HasField("t") and _is_external(attribute.t):
            raise refuse("external-data", "it keeps constants in another file")
    if node.domain not in OPSETS:
        raise refuse("domain", f"it has operators of {node.domain[:60]!r}")
    operator = OPERATORS.get((node.domain, node.op_type))
    if operator is None or node.overload:
        raise refuse("operator", f"it has the operator {node.op_type[:60]!r}")
    least, most = operator.inputs
    if not least <= len(node.input) <= most or "" in node.input or not 1 <= len(node.output) <= 2:
        raise refuse(
            "operator", f"{node.op_type} has {len(node.input)} inputs and {len(node.output)} outputs"
        )
    names = [attribute.name for attribute in node.attribute]
    if not operator.attributes.issuperset(names) or len(set(names)) < len(names):
        raise refuse("attribute", f"{node.op_type} has the attributes {', '.join(names)[:200]}")
    for attribute in node.attribute:
        if (
            attribute.name in FIXED
            and getattr(attribute, _VALUES.get(attribute.type, "name")) != FIXED[attribute.name]
        ):
            raise refuse(
                "attribute", f"{node.op_type} has {attribute.name} other than {FIXED[attribute.name]!r}"
            )
    if any(attribute.type not in _VALUES or attribute.ref_attr_name for attribute in node.attribute):
        raise refuse("attribute", f"{node.op_type} has an attribute that is no number, word, or list of them")


def _is_external(tensor: Any) -> bool:
    return bool(tensor.data_location or tensor.external_data)


def _constants(graph: Any) -> dict[str, np.ndarray]:
    """Constants by name, as views of the model's bytes where these are raw."""
    if graph.sparse_initializer:
        raise refuse("type", "it has sparse constants")
    constants: dict[str, np.ndarray] = {}
    total = 0
    for tensor in graph.initializer:
        if _is_external(tensor):
            raise refuse("external-data", "it keeps weights in another file")
        if tensor.name in constants:
            raise refuse("graph", f"it names the constant {tensor.name[:60]!r} twice")
        constants[tensor.name] = array = _constant(tensor)
        total += array.nbytes
        if total > MAX_PARAMETER_BYTES:
            raise refuse("parameters", f"its parameters take more than {MAX_PARAMETER_BYTES} bytes")
    return constants


def _constant(tensor: Any) -> np.ndarray:
    kind = TYPES.get(tensor.data_type)
    if kind is None or tensor.HasField("segment"):
        raise refuse("type", f"the constant {tensor.name[:60]!r} is of type {tensor.data_type}")
    dims = tuple(tensor.dims)
    if (
        len(dims) > MAX_RANK
        or min(dims, default=0) < 0
        or size_of(dims) * kind.itemsize > MAX_PARAMETER_BYTES
    ):
        raise refuse("parameters", f"the constant {tensor.name[:60]!r} has the shape {list(dims)[:9]}")
    if tensor.raw_data:
        values = np.frombuffer(tensor.raw_data, kind) if len(tensor.raw_data) % kind.itemsize == 0 else None
    else:
        values = np.asarray(getattr(tensor, _LISTS[tensor.data_type])).astype(kind)
    if values is None or values.size != size_of(dims):
        raise refuse("initializer", f"the constant {tensor.name[:60]!r} has other bytes than its shape needs")
    if kind.kind == "f" and not np.isfinite(values).all():
        raise refuse("weights", f"the constant {tensor.name[:60]!r} holds NaN or infinity")
    return values.reshape(dims)


def _check_interface(graph: Any, image: tuple[int, int, int], outputs: int) -> None:
    for values, name, wanted in ((graph.input, "image", image), (graph.output, "value", (outputs,))):
        stated = [(one.name, one.type.tensor_type.elem_type, _dims(one)) for one in values]
        if stated != [(name, FLOAT, wanted)]:
            raise refuse("interface", f"it states {stated!s:.200}, its card {name} {list(wanted)}")


def _dims(value: Any) -> tuple[int, ...]:
    dims = value.type.tensor_type.shape.dim
    return tuple(one.dim_value if one.HasField("dim_value") else -1 for one in dims[1:])


def _shapes(graph: Any, constants: Mapping[str, np.ndarray], image: Shape) -> dict[str, Shape]:
    shapes: dict[str, Shape] = {name: array.shape for name, array in constants.items()}
    if "image" in shapes:
        raise refuse("graph", "it names a constant as its input")
    shapes["image"] = image
    total, work = size_of(image), 0
    for node in graph.node:
        made, steps = _inferred(node, shapes, constants)
        for name, shape in zip(node.output, made, strict=False):
            if name in shapes or not name:
                raise refuse("graph", f"it makes {name[:60]!r} twice")
            shapes[name] = shape
            total += size_of(shape)
        work += steps
        if total * BYTES_PER_ELEMENT > MAX_TENSOR_BYTES * image[0]:
            raise refuse("memory", f"its tensors take more than {MAX_TENSOR_BYTES} bytes for one image")
        if work > MAX_WORK * image[0]:
            raise refuse("work", f"it takes more than {MAX_WORK} multiply-adds for one image")
    return shapes


def _inferred(
    node: Any, shapes: Mapping[str, Shape], constants: Mapping[str, np.ndarray]
) -> tuple[list[Shape], int]:
    for name in node.input:
        if name not in shapes:
            raise refuse("graph", f"{node.op_type} takes {name[:60]!r}, which nothing before it makes")
    attributes = {one.name: getattr(one, _VALUES[one.type]) for one in node.attribute}
    if node.op_type == "TreeEnsembleRegressor":
        _check_trees(attributes, shapes[node.input[0]])
    if node.op_type == "Cast" and attributes.get("to") not in TYPES:
        raise refuse("type", f"Cast to the type {attributes.get('to')}")
    whole = (constants.get(name) for name in node.input)
    call = Call(
        node.op_type,
        tuple(shapes[name] for name in node.input),
        attributes,
        tuple(one if one is not None and one.dtype == np.int64 else None for one in whole),
        len(node.output),
    )
    made, steps = OPERATORS[node.domain, node.op_type].infer(call)
    if len(node.output) > len(made) or any(len(shape) > MAX_RANK for shape in made):
        raise refuse("shape", f"{node.op_type} makes tensors of rank above {MAX_RANK}, or too many")
    return made, steps


def _check_batches(shapes: Iterable[Mapping[str, Shape]]) -> None:
    """Refuse a tensor that depends on the number of images other than by its first axis."""
    few, more = shapes
    for name, shape in few.items():
        scaled = (BATCHES[1], *shape[1:]) if shape[:1] == BATCHES[:1] else shape
        if more[name] not in (shape, scaled):
            raise refuse("batch", f"the tensor {name[:60]!r} does not grow in step with the number of images")


def _check_trees(attributes: Mapping[str, Any], features: Shape) -> None:
    """Refuse node links that form no trees, which a runtime would follow endlessly."""
    columns = {
        key: np.asarray(value) for key, value in attributes.items() if key.startswith(("nodes_", "target_"))
    }
    sizes = {len(value) for key, value in columns.items() if key.startswith("nodes_")}
    targets = {len(value) for key, value in columns.items() if key.startswith("target_")}
    words = (attributes.get("aggregate_function"), attributes.get("post_transform"))
    if len(columns) != 11 or len(sizes) != 1 or len(targets) != 1 or words != (b"SUM", b"NONE"):
        raise refuse("trees", "its trees lack columns, or have columns of several lengths")
    trees, ids = columns["nodes_treeids"], columns["nodes_nodeids"]
    begins = np.flatnonzero(np.r_[True, trees[1:] != trees[:-1]]) if len(trees) else np.empty(0, np.int64)
    number = np.repeat(np.arange(len(begins)), np.diff(np.r_[begins, len(trees)]))
    if (
        not len(trees)
        or not np.array_equal(trees, number)
        or not np.array_equal(ids, np.arange(len(ids)) - begins[number])
    ):
        raise refuse("trees", "its trees or their nodes are not numbered from 0")
    leaf = columns["nodes_modes"] == b"LEAF"
    if not (leaf | (columns["nodes_modes"] == b"BRANCH_LEQ")).all():
        raise refuse("trees", "its trees have nodes that are neither leaves nor thresholds")
    inner, counts = np.flatnonzero(~leaf), np.diff(np.r_[begins, len(trees)])
    children = np.stack([columns["nodes_truenodeids"], columns["nodes_falsenodeids"]])[:, inner]
    if (children <= ids[inner]).any() or (children >= counts[number[inner]]).any():
        raise refuse("trees", "its trees have links that do not lead down")
    met = np.bincount((children + begins[number[inner]]).ravel(), minlength=len(trees))
    roots = np.zeros(len(trees), bool)
    roots[begins] = True
    if not np.array_equal(met, np.where(roots, 0, 1)):
        raise refuse("trees", "its trees have nodes with several parents or none")
    _check_depth(inner, children + begins[number[inner]], begins)
    used = columns["nodes_featureids"]
    count = int(attributes.get("n_targets", 0))
    values = np.r_[columns["nodes_values"], columns["target_weights"]]
    if len(features) != 2 or used.min() < 0 or used.max() >= features[1] or not np.isfinite(values).all():
        raise refuse("trees", "its trees look at features that are not there, or hold NaN")
    place = columns["target_ids"]
    at = (columns["target_treeids"], columns["target_nodeids"])
    known = set(zip(trees[leaf].tolist(), ids[leaf].tolist(), strict=True))
    if (
        not len(place)
        or place.min() < 0
        or place.max() >= count
        or not known.issuperset(zip(*(c.tolist() for c in at), strict=True))
    ):
        raise refuse(
            "trees", "its trees have values at nodes that are no leaves, or for targets that are not there"
        )


def _check_depth(inner: np.ndarray, children: np.ndarray, roots: np.ndarray) -> None:
    below = {int(node): pair for node, pair in zip(inner, children.T.tolist(), strict=True)}
    level = roots.tolist()
    for _ in range(MAX_TREE_DEPTH):
        level = [child for node in level for child in below.get(node, ())]
        if not level:
            return
    raise refuse("trees", f"its trees are deeper than {MAX_TREE_DEPTH}")

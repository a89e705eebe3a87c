"""Calibrations from a stranger: each is refused by its code, before a runtime sees it, in at most 1 GB."""

import ast
import io
import json
import os
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, defs, helper, numpy_helper
from tests.refusals import refused

from palpate.core import CertificateError
from palpate.core.files import sha256_of
from palpate.estimators import Estimator
from palpate.estimators.admission import OPERATORS, admit_model
from palpate.estimators.admission.model_admission import MAX_NODES, MAX_PARAMETER_BYTES, MAX_TREE_DEPTH
from palpate.estimators.card_ground import card_id

SHAPE = (1, 24, 32)
OUTPUTS = 2
MEMORY_BYTES = 1_000_000_000
OPENED = """
import json, sys
from pathlib import Path
from palpate.core import PalpateError
from palpate.estimators import Estimator

codes = {}
for folder in sorted(Path(sys.argv[1]).iterdir()):
    try:
        Estimator.open(folder)
        codes[folder.name] = "opened"
    except PalpateError as e:
        codes[folder.name] = e.code
    except BaseException as e:
        codes[folder.name] = f"outside the tree: {type(e).__name__}: {e}"
status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
print(json.dumps([codes, 1024 * int(status["VmHWM"].split()[0])]))  # getrusage includes the parent's memory
"""

Node = onnx.NodeProto
node = helper.make_node


def model(nodes, weights=None, change: Callable = lambda whole: None, **how) -> bytes:
    """A model from `image` to `value` with the nodes before two values are taken of `last`."""
    constants = {"w": np.zeros((1, OUTPUTS), np.float32), "one": np.array([0]), **(weights or {})}
    nodes = [
        *nodes,
        node("Flatten", ["last"], ["flat"]),
        node("Gather", ["flat", "one"], ["first"], axis=1),
        node("MatMul", ["first", "w"], ["value"]),
    ]
    graph = helper.make_graph(
        nodes,
        "hostile",
        [helper.make_tensor_value_info("image", TensorProto.FLOAT, ["n", *how.get("shape", SHAPE)])],
        [helper.make_tensor_value_info("value", TensorProto.FLOAT, ["n", OUTPUTS])],
        [numpy_helper.from_array(np.ascontiguousarray(v), k) for k, v in constants.items()],
    )
    opsets = [helper.make_opsetid(*one) for one in how.get("opsets", [("", 18)])]
    whole = helper.make_model(graph, opset_imports=opsets, ir_version=9)
    change(whole)
    return whole.SerializeToString()


RELU = [node("Relu", ["image"], ["last"])]


def whole_numbers(*values: int) -> np.ndarray:
    return np.array(values, np.int64)


def huge_dims(whole: onnx.ModelProto) -> None:
    tensor = whole.graph.initializer.add()
    tensor.name, tensor.data_type = "huge", TensorProto.FLOAT
    tensor.dims.extend([100_000, 64_000])


def no_data(whole: onnx.ModelProto) -> None:
    tensor = whole.graph.initializer.add()
    tensor.name, tensor.data_type = "empty", TensorProto.FLOAT
    tensor.dims.extend([1000, 1000])


def external(whole: onnx.ModelProto) -> None:
    tensor = whole.graph.initializer[0]
    tensor.data_location = TensorProto.EXTERNAL
    entry = tensor.external_data.add()
    entry.key, entry.value = "location", "../../../etc/passwd"


def function(whole: onnx.ModelProto) -> None:
    whole.functions.append(
        helper.make_function(
            "", "Relu", ["x"], ["y"], [node("Relu", ["x"], ["y"])], [helper.make_opsetid("", 18)]
        )
    )


def sparse(whole: onnx.ModelProto) -> None:
    whole.graph.sparse_initializer.append(
        helper.make_sparse_tensor(
            numpy_helper.from_array(np.ones(1, np.float32), "s"),
            numpy_helper.from_array(whole_numbers(0), "i"),
            [1 << 40],
        )
    )


def body() -> onnx.GraphProto:
    return helper.make_graph([node("Relu", ["image"], ["out"])], "body", [], [])


def loop() -> bytes:
    return model([node("Loop", ["one", "", "image"], ["last"], body=body())])


def grown(times: int) -> list[Node]:
    names = ["image", *(f"wide{k}" for k in range(times - 1)), "last"]
    return [node("Concat", [a, a], [b], axis=1) for a, b in pairwise(names)]


def trees(children: list[tuple[int, int]], feature: int = 0) -> bytes:
    """One tree from the children of each node; (0, 0) is a leaf."""
    leaf = [pair == (0, 0) for pair in children]
    ids = list(range(len(children)))
    columns = {
        "nodes_treeids": [0] * len(ids), "nodes_nodeids": ids, "nodes_featureids": [feature] * len(ids),
        "nodes_values": [0.5] * len(ids), "nodes_truenodeids": [a for a, _ in children],
        "nodes_falsenodeids": [b for _, b in children],
        "nodes_modes": ["LEAF" if one else "BRANCH_LEQ" for one in leaf],
    }  # fmt: skip
    at = [i for i in ids if leaf[i]] or [0]
    targets = {
        "target_treeids": [0] * len(at), "target_nodeids": at, "target_ids": [0] * len(at),
        "target_weights": [1.0] * len(at),
    }  # fmt: skip
    ensemble = node(
        "TreeEnsembleRegressor", ["flat0"], ["last"], domain="ai.onnx.ml", n_targets=1,
        aggregate_function="SUM", post_transform="NONE", **columns, **targets,
    )  # fmt: skip
    return model([node("Flatten", ["image"], ["flat0"]), ensemble], opsets=[("", 18), ("ai.onnx.ml", 3)])


def chain(depth: int) -> list[tuple[int, int]]:
    children = []
    for k in range(depth):
        children += [(2 * k + 1, 2 * k + 2), (0, 0)]
    return [*children, (0, 0)]


MB = 1 << 20
WIDE = {"k": np.zeros((200_000, 1, 1, 1), np.float32)}
WORK = {"k": np.zeros((64, 1, 17, 17), np.float32), "m": np.zeros((64, 64, 17, 17), np.float32)}
CONVOLUTIONS = [
    node("Conv", [a, "k" if a == "image" else "m"], [b], pads=[8] * 4)
    for a, b in pairwise(["image", *(f"x{k}" for k in range(64)), "last"])
]
EVERY_PAIR = [
    node("Flatten", ["image"], ["f"]),
    node("Transpose", ["f"], ["t"], perm=[1, 0]),
    node("MatMul", ["f", "t"], ["last"]),
]
SHAPE_OF_DATA = [
    node("Cast", ["image"], ["s"], to=TensorProto.INT64),
    node("Reshape", ["image", "s"], ["last"]),
]
CHAIN = ["image", *(f"x{k}" for k in range(MAX_NODES + 1)), "last"]


def only(kind: str, *inputs: str, weights: dict | None = None, **attributes) -> Callable[[], bytes]:
    return lambda: model([node(kind, ["image", *inputs], ["last"], **attributes)], weights)


def relu(change: Callable = lambda whole: None, **how) -> Callable[[], bytes]:
    return lambda: model(RELU, change=change, **how)


MODELS: dict[str, tuple[Callable[[], bytes], str]] = {
    "expand": (only("Expand", "s", weights={"s": whole_numbers(10**6, 10**3, 24, 32)}), "onnx-operator"),
    "loop": (loop, "onnx-subgraph"),
    "a graph within an allowed operator": (only("Relu", hidden=body()), "onnx-subgraph"),
    "a wide convolution": (only("Conv", "k", weights=WIDE), "onnx-memory"),
    "a convolution's padding": (
        only("Conv", "k", weights={"k": np.zeros((1, 1, 3, 3), np.float32)}, pads=[10**5] * 4),
        "onnx-shape",
    ),
    "a convolution's work": (lambda: model(CONVOLUTIONS, WORK), "onnx-work"),
    "every image times every other": (lambda: model(EVERY_PAIR), "onnx-batch"),
    "doubled 40 times": (lambda: model(grown(40)), "onnx-memory"),
    "a shape from data": (lambda: model(SHAPE_OF_DATA), "onnx-shape"),
    "a function": (relu(function), "onnx-function"),
    "external data": (relu(external), "onnx-external-data"),
    "huge dims": (relu(huge_dims), "onnx-parameters"),
    "dims without data": (relu(no_data), "onnx-initializer"),
    "sparse weights": (relu(sparse), "onnx-type"),
    "NaN weights": (only("Mul", "k", weights={"k": np.array([np.nan], np.float32)}), "onnx-weights"),
    "the runtime's own domain": (
        lambda: model(
            [node("FusedConv", ["image", "w"], ["last"], domain="com.microsoft")],
            opsets=[("", 18), ("com.microsoft", 1)],
        ),
        "onnx-domain",
    ),
    "an opset that is not known": (relu(opsets=[("", 9999)]), "onnx-opset"),
    "an attribute that is not known": (
        only("MaxPool", kernel_shape=[2, 2], dilations=[9, 9]),
        "onnx-attribute",
    ),
    "too many nodes": (lambda: model([node("Relu", [a], [b]) for a, b in pairwise(CHAIN)]), "onnx-nodes"),
    "a circle": (
        lambda: model([node("Add", ["image", "b"], ["last"]), node("Relu", ["last"], ["b"])]),
        "onnx-graph",
    ),
    "a name twice": (lambda: model([*RELU, node("Abs", ["image"], ["last"])]), "onnx-graph"),
    "another image": (relu(shape=(3, 5, 5)), "onnx-interface"),
    "sizes without a number": (relu(shape=(1, "h", "w")), "onnx-interface"),
    "trees in a circle": (lambda: trees([(1, 2), (2, 1), (0, 0)]), "onnx-trees"),
    "trees too deep": (lambda: trees(chain(MAX_TREE_DEPTH + 1)), "onnx-trees"),
    "trees of a feature that is not there": (lambda: trees([(1, 2), (0, 0), (0, 0)], 10**9), "onnx-trees"),
    "no model": (lambda: b"not a model", "onnx-damaged"),
    "truncated": (lambda: model(RELU)[:-7], "onnx-damaged"),
    "larger than any": (lambda: b"\0" * (MAX_PARAMETER_BYTES + 32 * MB), "onnx-parameters"),
}


# Models that would take the most memory, opened in a process of their own.
GREEDY = ("expand", "a wide convolution", "doubled 40 times", "huge dims", "larger than any")


def reseal(folder: Path, change: Callable) -> None:
    """Change a card and give it the id that belongs to the change, as a forger would."""
    card = json.loads((folder / "card.json").read_text())
    change(card)
    card["id"] = card_id(card)
    (folder / "card.json").write_text(json.dumps(card))


def with_model(folder: Path, data: bytes) -> None:
    path = folder / "model.onnx"
    path.write_bytes(data)
    reseal(folder, lambda card: card["model"].update(sha256=sha256_of(path)))


def with_guard(folder: Path, write: Callable[[zipfile.ZipFile, dict], None]) -> None:
    path = folder / "guard.npz"
    with np.load(path) as archive:
        parts = dict(archive)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        write(archive, parts)
    reseal(folder, lambda card: card["guard"].update(sha256=sha256_of(path)))


def npy(array: np.ndarray) -> bytes:
    data = io.BytesIO()
    np.save(data, array)
    return data.getvalue()


def bomb(archive: zipfile.ZipFile, parts: dict) -> None:
    for name, array in parts.items():
        archive.writestr(f"{name}.npy", npy(array if name != "thumbs" else np.zeros(50 * MB)))


def lying_header(archive: zipfile.ZipFile, parts: dict) -> None:
    for name, array in parts.items():
        data = npy(array)
        if name == "thumbs":
            data = data.replace(
                str(array.shape[0]).encode() + b",", b"9" * len(str(array.shape[0])) + b",", 1
            )
        archive.writestr(f"{name}.npy", data)


def objects(archive: zipfile.ZipFile, parts: dict) -> None:
    for name in parts:
        data = io.BytesIO()
        np.save(data, np.array([{}], object), allow_pickle=True)
        archive.writestr(f"{name}.npy", data.getvalue())


def one_name_twice(archive: zipfile.ZipFile, parts: dict) -> None:
    for name, array in parts.items():
        archive.writestr(f"{name}.npy", npy(array))
    with pytest.warns(UserWarning, match="Duplicate"):
        archive.writestr("thumbs.npy", npy(np.zeros(3)))


def card_text(change: Callable[[str], str]) -> Callable[[Path], None]:
    return lambda folder: (
        (folder / "card.json").write_text(change((folder / "card.json").read_text())) and None
    )


def rewritten_model(change: Callable[[bytes], bytes]) -> Callable[[Path], None]:
    def spoil(folder: Path) -> None:
        path = folder / "model.onnx"
        path.write_bytes(change(path.read_bytes()))

    return spoil


def a_pipe(folder: Path) -> None:
    (folder / "card.json").unlink()
    os.mkfifo(folder / "card.json")


def wide_image(folder: Path) -> None:
    size = (100_000, 100_000)
    with_model(folder, model(RELU, shape=(1, *size)))
    reseal(folder, lambda card: card["input"].update(size_px=size, channels=1))


FOLDERS: dict[str, tuple[Callable[[Path], object], str]] = {
    "bytes after the model": (rewritten_model(lambda data: data + b"\0"), "file-hash"),
    "a bomb in the guard": (lambda f: with_guard(f, bomb), "file-size"),
    "a guard's header that lies": (lambda f: with_guard(f, lying_header), "file-damaged"),
    "a guard of objects": (lambda f: with_guard(f, objects), "file-damaged"),
    "a guard's array twice": (lambda f: with_guard(f, one_name_twice), "file-damaged"),
    "a deep card": (card_text(lambda text: '{"id": ' + "[" * 100_000 + "]" * 100_000 + "}"), "card-damaged"),
    "a large card": (card_text(lambda text: text + " " * 5_000_000), "file-size"),
    "a card of NaN": (
        card_text(lambda text: text.replace('"coverage": 0.9', '"coverage": NaN')),
        "card-damaged",
    ),
    "an altered card": (card_text(lambda text: text.replace('"seed": 0', '"seed": 1')), "card-altered"),
    "a card that is a pipe": (a_pipe, "card-missing"),
    "a wide image": (wide_image, "onnx-memory"),
}  # fmt: skip


@pytest.fixture(scope="module")
def sound(tmp_path_factory, calibrate_spots, changes_untried):
    """A calibration of the size that the hostile models take, opened and resealed once to show that it is."""
    plan = {"targets": ("x_mm", "height_mm"), "split": "group:press", "size_px": SHAPE[1:], "model": "mean"}
    run, calibration = calibrate_spots(tmp_path_factory.mktemp("sound") / "cal", 10, **plan)
    with_model(calibration, model(RELU))
    assert Estimator.open(calibration).read(run.frame(1))["x_mm"].value == 0.0
    return calibration


@pytest.fixture(scope="module")
def opened(sound, tmp_path_factory):
    """Codes of all hostile calibrations, and the memory that opening them in one process took [bytes]."""
    folder = tmp_path_factory.mktemp("hostile")
    for name in GREEDY:
        shutil.copytree(sound, folder / name)
        with_model(folder / name, MODELS[name][0]())
    for name, (spoil, _) in FOLDERS.items():
        shutil.copytree(sound, folder / name)
        spoil(folder / name)
    command = [sys.executable, "-c", OPENED, str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=200, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    codes, memory = json.loads(done.stdout)
    return codes, memory


@pytest.mark.parametrize("name", MODELS)
def test_a_hostile_model_is_refused_by_its_code(name: str) -> None:
    make, code = MODELS[name]
    with refused(code, CertificateError):
        admit_model(make(), name, SHAPE, OUTPUTS)


@pytest.mark.parametrize("name", [*GREEDY, *FOLDERS])
def test_a_hostile_calibration_is_refused_by_its_code(opened, name: str) -> None:
    assert opened[0][name] == (MODELS | FOLDERS)[name][1]


def test_refusing_them_all_takes_at_most_a_gigabyte(opened) -> None:
    assert opened[1] < MEMORY_BYTES


def test_a_runtime_that_fails_as_it_reads_is_an_error_with_a_code(sound) -> None:
    with refused("onnx-runtime", CertificateError):
        Estimator.open(sound).values(np.zeros((1, 1, 5, 5), np.float32))


def test_trees_of_the_greatest_depth_are_admitted() -> None:
    admit_model(trees(chain(MAX_TREE_DEPTH - 1)), "trees", SHAPE, OUTPUTS)


def test_the_list_of_operators_is_that_of_the_exporters() -> None:
    """int8 adds rounding and its reversal; ReduceMean is for models of users, such as that of the how-to."""
    source = Path(__file__).parents[2] / "src" / "palpate"
    known = {schema.name for schema in defs.get_all_schemas()}
    named = set()
    for path in source.rglob("*.py"):
        text = path.read_text()
        if "admission" not in path.parts and any(
            mark in text for mark in ("make_node(", "graph.add(", "self.add(")
        ):
            constants = (one.value for one in ast.walk(ast.parse(text)) if isinstance(one, ast.Constant))
            named |= {one for one in constants if isinstance(one, str)} & known
    assert {name for _, name in OPERATORS} == named | {"QuantizeLinear", "DequantizeLinear", "ReduceMean"}

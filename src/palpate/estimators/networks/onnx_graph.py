"""Small ONNX graphs, grown a node at a time and checked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
import onnx
from numpy.typing import ArrayLike
from onnx import TensorProto, helper, numpy_helper

OPSET = 18
TREES_OPSET = 3  # opset of ai.onnx.ml for trees
# The newest IR that the oldest onnxruntime allowed by the dependencies reads.
IR_VERSION = 9

Weights = Mapping[str, np.ndarray]
EMPTY: Weights = MappingProxyType({})


class OnnxGraph:
    """Graph that begins at the node `image`; every method adds to it and returns a name."""

    def __init__(self) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.constants: dict[str, np.ndarray] = {}

    def add(
        self, kind: str, inputs: Sequence[str], weights: Weights = EMPTY, *, output: str = "", **how: object
    ) -> str:
        """Add a node, whose weights follow its inputs; return the name of its output."""
        names = {f"{name}{len(self.nodes)}": value for name, value in weights.items()}
        self.constants |= names
        name = output or f"x{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, [*inputs, *names], [name], **how))
        return name

    def add_trees(self, forest: Any, at: str) -> str:
        """Add the mean of scikit-learn's regression trees of float32 features ``[n f]``.

        Thresholds are rounded down to float32, so that each feature goes to the same side as in scikit-learn.
        """
        nodes: dict[str, list[np.ndarray]] = {name: [] for name in TREE_NODES}
        leaves: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
        for number, tree in enumerate(one.tree_ for one in forest.estimators_):
            ids, leaf = np.arange(tree.node_count), tree.children_left < 0
            for name, column in zip(TREE_NODES, _tree_columns(tree, number, ids, leaf), strict=True):
                nodes[name].append(column)
            weights = tree.value[leaf, :, 0] / len(forest.estimators_)
            leaves.append((np.full(leaf.sum(), number), ids[leaf], weights))
        targets = leaves[0][2].shape[1]
        trees, ids, weights = (np.concatenate(part) for part in zip(*leaves, strict=True))
        name = f"x{len(self.nodes)}"
        modes = np.where(np.concatenate(nodes.pop("nodes_modes")), "LEAF", "BRANCH_LEQ")
        self.nodes.append(
            helper.make_node(
                "TreeEnsembleRegressor", [at], [name], domain="ai.onnx.ml",
                n_targets=targets, aggregate_function="SUM", post_transform="NONE",
                nodes_modes=modes.tolist(),
                target_treeids=np.repeat(trees, targets).tolist(),
                target_nodeids=np.repeat(ids, targets).tolist(),
                target_ids=np.tile(np.arange(targets), len(ids)).tolist(),
                target_weights=weights.ravel().tolist(),
                **{key: np.concatenate(parts).tolist() for key, parts in nodes.items()},
            )
        )  # fmt: skip
        return name

    def centred(self, at: str, level: ArrayLike, contrast: ArrayLike) -> str:
        """Add (x - level) / contrast, each one number or one a feature."""
        at = self.add("Sub", [at], {"level": _row(level)})
        return self.add("Div", [at], {"contrast": _row(contrast)})

    def restored(self, at: str, scale: ArrayLike, mean: ArrayLike, output: str = "") -> str:
        """Add x scale + mean, each one number or one a feature."""
        at = self.add("Mul", [at], {"scale": _row(scale)})
        return self.add("Add", [at], {"mean": _row(mean)}, output=output)

    def model(self, shape: tuple[int, int, int], targets: int) -> onnx.ModelProto:
        """Return the model from ``image [n c h w]`` to ``value [n t]``; a node must be named `value`."""
        return image_to_value(self.nodes, self.constants, shape, targets)


TREE_NODES = (
    "nodes_treeids", "nodes_nodeids", "nodes_featureids", "nodes_values", "nodes_truenodeids",
    "nodes_falsenodeids", "nodes_modes",
)  # fmt: skip


def _tree_columns(tree: Any, number: int, ids: np.ndarray, leaf: np.ndarray) -> tuple[np.ndarray, ...]:
    """Columns of `TREE_NODES` of a tree; the last marks leaves."""
    above = tree.threshold.astype(np.float32)
    above = np.where(above > tree.threshold, np.nextafter(above, np.float32(-np.inf)), above)
    branches = (np.where(leaf, 0, column) for column in (tree.feature, above))
    sides = (np.where(leaf, 0, column) for column in (tree.children_left, tree.children_right))
    return (np.full_like(ids, number), ids, *branches, *sides, leaf)


def _row(values: ArrayLike) -> np.ndarray:
    return np.asarray(values, np.float32)[None]


def image_to_value(
    nodes: Sequence[onnx.NodeProto], constants: Weights, shape: tuple[int, int, int], targets: int
) -> onnx.ModelProto:
    """Return a model from ``image [n c h w]`` to ``value [n t]``, with weights by name."""
    graph = helper.make_graph(
        list(nodes),
        "palpate",
        [helper.make_tensor_value_info("image", TensorProto.FLOAT, ["n", *shape])],
        [helper.make_tensor_value_info("value", TensorProto.FLOAT, ["n", targets])],
        [numpy_helper.from_array(np.ascontiguousarray(v), k) for k, v in constants.items()],
    )
    domains = {"": OPSET} | {node.domain: TREES_OPSET for node in nodes if node.domain}
    opsets = [helper.make_opsetid(domain, version) for domain, version in domains.items()]
    model = helper.make_model(graph, opset_imports=opsets, ir_version=IR_VERSION, producer_name="palpate")
    onnx.checker.check_model(model, full_check=True)
    return model

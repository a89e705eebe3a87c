"""ONNX nodes for the layers of torch networks, grown a layer at a time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import onnx
import torch
from onnx import helper
from torch import nn

from palpate.estimators.networks.onnx_graph import image_to_value
from palpate.estimators.networks.resnet import BasicBlock, ResNet18


class TorchGraph:
    """A graph that begins at the node `image`; every method adds to it and names what it has made.

    Layers are written as they answer once trained: batch normalisation with its running mean and variance.
    """

    def __init__(self) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.constants: dict[str, np.ndarray] = {}

    def model(self, shape: tuple[int, int, int], targets: int) -> onnx.ModelProto:
        """All of it as a model from ``image [n c h w]`` to ``value [n t]``; a node must be named `value`."""
        return image_to_value(self.nodes, self.constants, shape, targets)

    def add(
        self,
        kind: str,
        inputs: Sequence[str],
        weights: Mapping[str, torch.Tensor],
        *,
        output: str = "",
        **how: object,
    ) -> str:
        """Add a node and its weights; returns the name of what it makes."""
        names = {f"{name}{len(self.nodes)}": value for name, value in weights.items()}
        self.constants |= {name: value.detach().numpy() for name, value in names.items()}
        name = output or f"x{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, [*inputs, *names], [name], **how))
        return name

    def add_chain(self, layers: Iterable[nn.Module], at: str) -> str:
        """Add layers one after the other, the first after the node named `at`."""
        for layer in layers:
            at = self.add_layer(layer, at)
        return at

    def add_layer(self, layer: nn.Module, at: str) -> str:
        """Add one layer after the node named `at`; returns the name of what it makes.

        Raises:
            TypeError: no ONNX form is written for such a layer.
        """
        match layer:
            case nn.Conv2d() if layer.groups == 1 and set(layer.dilation) == {1}:
                weights = {"w": layer.weight} | ({} if layer.bias is None else {"b": layer.bias})
                return self.add("Conv", [at], weights, pads=_both_ends(layer), strides=list(layer.stride))
            case nn.BatchNorm2d():
                weights = {
                    "g": layer.weight,
                    "b": layer.bias,
                    "m": layer.running_mean,
                    "v": layer.running_var,
                }
                return self.add("BatchNormalization", [at], weights, epsilon=layer.eps)
            case nn.ReLU():
                return self.add("Relu", [at], {})
            case nn.MaxPool2d() if layer.dilation == 1 and not layer.ceil_mode:
                kernel, strides = _pair(layer.kernel_size), _pair(layer.stride)
                pads = _both_ends(layer)
                return self.add("MaxPool", [at], {}, kernel_shape=kernel, strides=strides, pads=pads)
            case nn.AdaptiveAvgPool2d() if layer.output_size == 1:
                return self.add("GlobalAveragePool", [at], {})
            case nn.Flatten():
                return self.add("Flatten", [at], {})
            case nn.Linear():
                return self.add("Gemm", [at], {"w": layer.weight, "b": layer.bias}, transB=1)
            case nn.Sequential():
                return self.add_chain(layer, at)
            case BasicBlock():
                return self._residual(layer, at)
            case ResNet18():
                return self.add_chain(layer.chain(), at)
            case _:
                raise TypeError(f"no ONNX form is written for {layer}")

    def _residual(self, block: BasicBlock, at: str) -> str:
        """A block's two convolutions, and its shortcut round them."""
        around = at if block.downsample is None else self.add_chain(block.downsample, at)
        through = self.add_chain((block.conv1, block.bn1, block.relu, block.conv2, block.bn2), at)
        return self.add("Relu", [self.add("Add", [through, around], {})], {})

    def columns(self, at: str, first: int, end: int) -> str:
        """The columns from `first` up to, not including, `end` of images ``[n c h w]``."""
        bounds = {"first": torch.tensor([first]), "end": torch.tensor([end]), "axis": torch.tensor([3])}
        return self.add("Slice", [at], bounds)

    def centres(self, maps: nn.Conv2d, grid: torch.Tensor, at: str) -> str:
        """Centres of a layer's maps: the softmax of each, times a grid of places ``[h w, 2]``."""
        shape = torch.tensor([0, maps.out_channels, len(grid)])
        flat = self.add("Reshape", [self.add_layer(maps, at)], {"shape": shape})
        return self.add(
            "Flatten", [self.add("MatMul", [self.add("Softmax", [flat], {}, axis=2)], {"grid": grid})], {}
        )

    def joined(self, *parts: str) -> str:
        """Features ``[n k]`` side by side, in the order given."""
        return self.add("Concat", parts, {}, axis=1)

    def picked(self, at: str, order: Sequence[int]) -> str:
        """Features ``[n k]`` in another order."""
        node = helper.make_node("Gather", [at, f"order{len(self.nodes)}"], [f"x{len(self.nodes)}"], axis=1)
        self.constants[f"order{len(self.nodes)}"] = np.array(order, np.int64)
        self.nodes.append(node)
        return f"x{len(self.nodes) - 1}"

    def centred(self, at: str, level: torch.Tensor, contrast: torch.Tensor) -> str:
        """(x - level) / contrast, each one number or one a feature."""
        at = self.add("Sub", [at], {"level": level[None]})
        return self.add("Div", [at], {"contrast": contrast[None]})

    def restored(self, at: str, scale: torch.Tensor, mean: torch.Tensor, output: str = "") -> str:
        """Scale and shift, x scale + mean, each one number or one a feature."""
        at = self.add("Mul", [at], {"scale": scale[None]})
        return self.add("Add", [at], {"mean": mean[None]}, output=output)


def _pair(size: int | tuple[int, int]) -> list[int]:
    return [size, size] if isinstance(size, int) else list(size)


def _both_ends(layer: nn.Module) -> list[int]:
    """A layer's padding as ONNX asks for it: before rows and columns, then after them."""
    return 2 * _pair(layer.padding)

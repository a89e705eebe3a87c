"""ONNX nodes for the layers of torch networks, grown a layer at a time."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from palpate.core.optional_imports import optional_imports
from palpate.estimators.networks.onnx_graph import OnnxGraph
from palpate.estimators.networks.resnet import BasicBlock, ResNet18

with optional_imports("A network"):
    import torch
    from torch import nn


class TorchGraph(OnnxGraph):
    """ONNX graph of torch layers in evaluation mode."""

    def add_chain(self, layers: Iterable[nn.Module], at: str) -> str:
        for layer in layers:
            at = self.add_layer(layer, at)
        return at

    def add_layer(self, layer: nn.Module, at: str) -> str:
        match layer:
            case nn.Conv2d() if layer.groups == 1 and set(layer.dilation) == {1}:
                weights = _arrays(w=layer.weight, b=layer.bias)
                return self.add("Conv", [at], weights, pads=_both_ends(layer), strides=list(layer.stride))
            case nn.BatchNorm2d():
                weights = _arrays(g=layer.weight, b=layer.bias, m=layer.running_mean, v=layer.running_var)
                return self.add("BatchNormalization", [at], weights, epsilon=layer.eps)
            case nn.ReLU():
                return self.add("Relu", [at])
            case nn.MaxPool2d() if layer.dilation == 1 and not layer.ceil_mode:
                kernel, strides = _pair(layer.kernel_size), _pair(layer.stride)
                pads = _both_ends(layer)
                return self.add("MaxPool", [at], kernel_shape=kernel, strides=strides, pads=pads)
            case nn.AdaptiveAvgPool2d() if layer.output_size == 1:
                return self.add("GlobalAveragePool", [at])
            case nn.Flatten():
                return self.add("Flatten", [at])
            case nn.Linear():
                return self.add("Gemm", [at], _arrays(w=layer.weight, b=layer.bias), transB=1)
            case nn.Sequential():
                return self.add_chain(layer, at)
            case BasicBlock():
                return self._residual(layer, at)
            case ResNet18():
                return self.add_chain(layer.chain(), at)
            case _:
                raise TypeError(f"no ONNX form is written for {layer}")

    def _residual(self, block: BasicBlock, at: str) -> str:
        around = at if block.downsample is None else self.add_chain(block.downsample, at)
        through = self.add_chain((block.conv1, block.bn1, block.relu, block.conv2, block.bn2), at)
        return self.add("Relu", [self.add("Add", [through, around])])

    def columns(self, at: str, first: int, end: int) -> str:
        """Add the image columns from `first` up to, not including, `end`."""
        bounds = {"first": first, "end": end, "axis": 3}
        return self.add("Slice", [at], {name: np.array([place]) for name, place in bounds.items()})

    def centres(self, maps: nn.Conv2d, grid: torch.Tensor, at: str) -> str:
        """Add the centers of a layer's maps: softmax times a grid of positions ``[h w, 2]``."""
        shape = np.array([0, maps.out_channels, len(grid)])
        flat = self.add("Reshape", [self.add_layer(maps, at)], {"shape": shape})
        centres = self.add("MatMul", [self.add("Softmax", [flat], axis=2)], _arrays(grid=grid))
        return self.add("Flatten", [centres])

    def joined(self, *parts: str) -> str:
        return self.add("Concat", parts, axis=1)

    def picked(self, at: str, order: Sequence[int]) -> str:
        return self.add("Gather", [at], {"order": np.array(order, np.int64)}, axis=1)


def _arrays(**weights: torch.Tensor | None) -> dict[str, np.ndarray]:
    """Weights that are present, by name."""
    return {name: value.numpy(force=True) for name, value in weights.items() if value is not None}


def _pair(size: int | tuple[int, int]) -> list[int]:
    return [size, size] if isinstance(size, int) else list(size)


def _both_ends(layer: nn.Module) -> list[int]:
    """Padding in ONNX order: before rows and columns, then after them."""
    return 2 * _pair(layer.padding)

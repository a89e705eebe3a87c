"""ResNet-18 without its last layer, with torchvision's parameter names.

Reference: He, Zhang, Ren & Sun, Deep residual learning for image recognition, CVPR (2016), table 1,
doi:10.1109/CVPR.2016.90.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from palpate.core import InputError
from palpate.core.optional_imports import optional_imports, require

with optional_imports("A network"):
    import torch
    from torch import nn

FEATURES = 512


class BasicBlock(nn.Module):  # type: ignore[misc]  # torch is seen as Any, so that checking needs no torch
    """Two 3 x 3 convolutions and a shortcut."""

    def __init__(self, channels: int, features: int, stride: int = 1) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(channels, features, 3, stride=stride, padding=1, bias=False)
        self.bn1 = nn.BatchNorm2d(features)
        self.relu = nn.ReLU(inplace=True)
        self.conv2 = nn.Conv2d(features, features, 3, padding=1, bias=False)
        self.bn2 = nn.BatchNorm2d(features)
        self.downsample: nn.Sequential | None = None
        if stride != 1 or channels != features:
            narrow = nn.Conv2d(channels, features, 1, stride=stride, bias=False)
            self.downsample = nn.Sequential(narrow, nn.BatchNorm2d(features))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        around = x if self.downsample is None else self.downsample(x)
        through = self.bn2(self.conv2(self.relu(self.bn1(self.conv1(x)))))
        return self.relu(through + around)


class ResNet18(nn.Module):  # type: ignore[misc]
    """Map of images ``[n c h w]`` to features ``[n 512]``, initialized after He et al. (2015)."""

    def __init__(self, channels: int = 3) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(channels, 64, 7, stride=2, padding=3, bias=False)
        self.bn1 = nn.BatchNorm2d(64)
        self.relu = nn.ReLU(inplace=True)
        self.maxpool = nn.MaxPool2d(3, stride=2, padding=1)
        self.layer1 = nn.Sequential(BasicBlock(64, 64), BasicBlock(64, 64))
        self.layer2 = nn.Sequential(BasicBlock(64, 128, 2), BasicBlock(128, 128))
        self.layer3 = nn.Sequential(BasicBlock(128, 256, 2), BasicBlock(256, 256))
        self.layer4 = nn.Sequential(BasicBlock(256, FEATURES, 2), BasicBlock(FEATURES, FEATURES))
        self.avgpool = nn.AdaptiveAvgPool2d(1)
        self.flatten = nn.Flatten()
        for part in self.modules():
            if isinstance(part, nn.Conv2d):
                nn.init.kaiming_normal_(part.weight, mode="fan_out", nonlinearity="relu")

    def chain(self) -> Iterator[nn.Module]:
        yield from (self.conv1, self.bn1, self.relu, self.maxpool)
        yield from (self.layer1, self.layer2, self.layer3, self.layer4)
        yield from (self.avgpool, self.flatten)

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        for part in self.chain():
            image = part(image)
        return image

    def load_weights(self, path: Path) -> None:
        """Take weights from a file with torchvision's names; see `take`."""
        self.take(read_weights(path), str(path))

    def take(self, weights: Mapping[str, torch.Tensor], source: str) -> None:
        """Take weights of a color ResNet-18 except the last layer, summed over colors for gray images."""
        mine = self.state_dict()
        trunk = {k: v for k, v in weights.items() if not k.startswith("fc.")}
        # Files written by older versions of torch do not count batches, and nothing here reads the count.
        needed = {k for k in mine if not k.endswith("num_batches_tracked")}
        missing, extra = sorted(needed - set(trunk)), sorted(set(trunk) - set(mine))
        if missing or extra:
            raise InputError(
                f"{source} does not fit ResNet-18: missing {_listed(missing)}; extra {_listed(extra)}",
                code="weights-names",
            )
        if mine["conv1.weight"].shape[1] == 1:
            trunk["conv1.weight"] = trunk["conv1.weight"].float().sum(dim=1, keepdim=True)
        unlike = [
            f"{k} {list(v.shape)}, not {list(mine[k].shape)}"
            for k, v in trunk.items()
            if v.shape != mine[k].shape
        ]
        if unlike:
            raise InputError(f"{source} has other shapes: {_listed(unlike)}", code="weights-shape")
        self.load_state_dict(mine | trunk)


def check_weights(path: Path) -> None:
    """Refuse a path from which no weights can be read."""
    if path.suffix != ".safetensors":
        raise InputError(
            f"weights {path}: only .safetensors files are read, as others can run code; convert the file",
            code="weights-kind",
        )
    if not path.is_file():
        raise InputError(f"weights {path}: there is no such file", code="file-missing")


def read_weights(path: Path) -> dict[str, torch.Tensor]:
    """Return all arrays of a `.safetensors` file by name."""
    check_weights(path)
    load = require("safetensors.torch", f"A file of weights such as {path}").load_file
    try:
        return dict(load(path))
    except Exception as e:  # the package's own error, which cannot be named where it is not installed
        raise InputError(f"weights {path} cannot be read: {e}", code="weights-unreadable") from e


def _listed(names: list[str]) -> str:
    """First few names, and the number of others."""
    first, more = ", ".join(names[:8]) or "none", len(names) - 8
    return f"{first} and {more} more" if more > 0 else first

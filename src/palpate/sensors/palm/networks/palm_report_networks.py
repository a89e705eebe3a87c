"""The photoelastic palm's joint network: two residual networks on raw colour crops, two heads on both.

phi_F = ResNet18(fringe crop), phi_L = ResNet18(mirror crop), z = [phi_F, phi_L]; the force (x, y, normal) is
one head's answer to z, the place (x, y) another's; the two mean squared errors count equally. The source
names no size for the heads: here each has one hidden layer of 256 with a rectifier.

The photoelastic palm's force-conditioned network: the place is estimated knowing the force.

As the joint network, on differences from the untouched sensor; one head answers the normal force alone, and
the other answers the place to [z, sg(F_z)]. The stop-gradient sg lets the force inform the place, and keeps
the place's errors from reaching the force's head. Errors count, and heads are built, as in the joint network.

The photoelastic palm's two-stage network: first where and how deep, then how hard.

d = ResNet18(fringe difference) and (x, y) = ResNet18(mirror difference), both grey, each by one dense layer
on its features; then (F_x, F_y, F_z, |F|) = MLP(d, x, y), which sees the image through those three numbers
alone. All is trained at once: w_d l(d) + w_l l(x, y) + w_F l(F), l the Huber loss, so that the force's errors
reach both residual networks too. The source names neither the weights nor the MLP's size: here the weights
are 1, and the MLP has two hidden layers of 64 with rectifiers. The Huber loss bends at 1, in units of the
target's spread where targets are standardised.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from palpate.core import InputError
from palpate.core.optional_imports import optional_imports
from palpate.estimators.networks.resnet import FEATURES, ResNet18
from palpate.estimators.networks.torch_export import TorchGraph
from palpate.sensors.palm.networks import FORCES, PLACE
from palpate.sensors.palm.networks.palm_training import (
    DEPTH,
    MAGNITUDE,
    PalmModel,
    PalmNetwork,
    Scales,
    TwoTrunks,
    dense,
)

with optional_imports("A network of the palm"):
    import torch
    from torch import nn
    from torch.nn import functional

HIDDEN = 256


class JointNetwork(TwoTrunks):
    """F = h_F(z), (x, y) = h_L(z)."""

    def __init__(self, channels: int, scales: Scales) -> None:
        super().__init__(channels, scales)
        self.force = dense((2 * FEATURES, HIDDEN, len(FORCES)))
        self.place = dense((2 * FEATURES, HIDDEN, len(PLACE)))

    def answer(self, fringe: torch.Tensor, mirror: torch.Tensor) -> torch.Tensor:
        z = self.joint(fringe, mirror)
        return torch.cat([self.force(z), self.place(z)], dim=1)

    def draw(self, graph: TorchGraph, fringe: str, mirror: str) -> str:
        z = self.draw_joint(graph, fringe, mirror)
        return graph.joined(graph.add_layer(self.force, z), graph.add_layer(self.place, z))


@dataclass(frozen=True)
class PalmJointRaw(PalmModel):
    """The joint multi-task network, for raw colour crops. See `PalmModel` for its options."""

    targets: ClassVar[tuple[str, ...]] = (*FORCES, *PLACE)

    def network(self, channels: int, scales: Scales) -> PalmNetwork:
        return JointNetwork(channels, scales)

    def loss(self, answer: torch.Tensor, wanted: torch.Tensor) -> torch.Tensor:
        """MSE(F) + MSE((x, y))."""
        n = len(FORCES)
        return functional.mse_loss(answer[:, :n], wanted[:, :n]) + functional.mse_loss(
            answer[:, n:], wanted[:, n:]
        )


class ConditionedNetwork(TwoTrunks):
    """F_z = h_F(z), (x, y) = h_L([z, sg(F_z)])."""

    def __init__(self, channels: int, scales: Scales) -> None:
        super().__init__(channels, scales)
        self.force = dense((2 * FEATURES, HIDDEN, 1))
        self.place = dense((2 * FEATURES + 1, HIDDEN, len(PLACE)))

    def answer(self, fringe: torch.Tensor, mirror: torch.Tensor) -> torch.Tensor:
        z = self.joint(fringe, mirror)
        force = self.force(z)
        return torch.cat([force, self.place(torch.cat([z, force.detach()], dim=1))], dim=1)

    def draw(self, graph: TorchGraph, fringe: str, mirror: str) -> str:
        z = self.draw_joint(graph, fringe, mirror)
        force = graph.add_layer(self.force, z)
        return graph.joined(force, graph.add_layer(self.place, graph.joined(z, force)))


@dataclass(frozen=True)
class PalmForceConditioned(PalmModel):
    """The force-conditioned network, for differential colour crops. See `PalmModel` for its options."""

    targets: ClassVar[tuple[str, ...]] = (FORCES[-1], *PLACE)

    def network(self, channels: int, scales: Scales) -> PalmNetwork:
        return ConditionedNetwork(channels, scales)

    def loss(self, answer: torch.Tensor, wanted: torch.Tensor) -> torch.Tensor:
        """MSE(F_z) + MSE((x, y))."""
        return functional.mse_loss(answer[:, :1], wanted[:, :1]) + functional.mse_loss(
            answer[:, 1:], wanted[:, 1:]
        )


TWO_STAGE_HIDDEN = 64


class TwoStageNetwork(PalmNetwork):
    """d = f_d(fringe), (x, y) = f_l(mirror), F = f_F(d, x, y)."""

    def __init__(self, channels: int, scales: Scales) -> None:
        super().__init__(scales)
        self.fringe, self.mirror = ResNet18(channels), ResNet18(channels)
        self.depth, self.place = nn.Linear(FEATURES, 1), nn.Linear(FEATURES, len(PLACE))
        self.force = dense((1 + len(PLACE), TWO_STAGE_HIDDEN, TWO_STAGE_HIDDEN, len(FORCES) + 1))

    def answer(self, fringe: torch.Tensor, mirror: torch.Tensor) -> torch.Tensor:
        pose = torch.cat([self.depth(self.fringe(fringe)), self.place(self.mirror(mirror))], dim=1)
        return torch.cat([pose, self.force(pose)], dim=1)

    def draw(self, graph: TorchGraph, fringe: str, mirror: str) -> str:
        depth = graph.add_chain((self.fringe, self.depth), fringe)
        pose = graph.joined(depth, graph.add_chain((self.mirror, self.place), mirror))
        return graph.joined(pose, graph.add_layer(self.force, pose))


@dataclass(frozen=True)
class PalmTwoStage(PalmModel):
    """The two-stage pipeline, for differential grey crops.

    Attributes:
        depth_weight, place_weight, force_weight: w_d, w_l and w_F of the loss.

    See `PalmModel` for the others; by default 50 epochs, stopped after 15 without gain on watched groups.
    """

    epochs: int = 50
    patience: int = 15
    depth_weight: float = 1.0
    place_weight: float = 1.0
    force_weight: float = 1.0

    targets: ClassVar[tuple[str, ...]] = (DEPTH, *PLACE, *FORCES, MAGNITUDE)

    def __post_init__(self) -> None:
        super().__post_init__()
        weights = (self.depth_weight, self.place_weight, self.force_weight)
        if not all(0 <= w < float("inf") for w in weights) or sum(weights) == 0:
            raise InputError(f"loss weights {weights}: give 0 or more, one positive", code="loss-weights")

    def network(self, channels: int, scales: Scales) -> PalmNetwork:
        return TwoStageNetwork(channels, scales)

    def loss(self, answer: torch.Tensor, wanted: torch.Tensor) -> torch.Tensor:
        """w_d l(d) + w_l l(x, y) + w_F l(F)."""
        huber = functional.smooth_l1_loss
        return (
            self.depth_weight * huber(answer[:, :1], wanted[:, :1])
            + self.place_weight * huber(answer[:, 1:3], wanted[:, 1:3])
            + self.force_weight * huber(answer[:, 3:], wanted[:, 3:])
        )

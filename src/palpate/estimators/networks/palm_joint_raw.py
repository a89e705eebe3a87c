"""The photoelastic palm's joint network: two residual networks on raw colour crops, two heads on both.

phi_F = ResNet18(fringe crop), phi_L = ResNet18(mirror crop), z = [phi_F, phi_L]; the force (x, y, normal) is
one head's answer to z, the place (x, y) another's; the two mean squared errors count equally. The source
names no size for the heads: here each has one hidden layer of 256 with a rectifier.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch.nn import functional

from palpate.estimators.networks.palm_network import PalmModel, PalmNetwork, TwoTrunks, dense
from palpate.estimators.networks.palm_views import FORCES, PLACE, Scales
from palpate.estimators.networks.resnet import FEATURES
from palpate.estimators.networks.torch_graph import TorchGraph

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

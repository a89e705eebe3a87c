"""The photoelastic palm's force-conditioned network: the place is estimated knowing the force.

As the joint network, on differences from the untouched sensor; one head answers the normal force alone, and
the other answers the place to [z, sg(F_z)]. The stop-gradient sg lets the force inform the place, and keeps
the place's errors from reaching the force's head. The two mean squared errors count equally. The source
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

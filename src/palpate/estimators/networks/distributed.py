"""Processes started by torchrun that train one network, each on its part of every batch.

They read torchrun's environment (RANK, LOCAL_RANK, WORLD_SIZE); without it there is one. Numbers and barriers
use gloo, gradients NCCL on GPUs; nothing is pickled. torch is imported only for several processes.
"""

from __future__ import annotations

import atexit
import os
from copy import deepcopy
from dataclasses import dataclass
from datetime import timedelta
from typing import TYPE_CHECKING

from palpate.core import Indices, InputError

if TYPE_CHECKING:
    import torch
    from torch import nn

# of one that waits: the first may pack a long recording. Where one fails, torchrun ends them all at once
PATIENCE = timedelta(days=1)


@dataclass(frozen=True, slots=True)
class ProcessGroup:
    """Cooperating processes, as seen by one of them.

    Attributes:
        rank: Index of this process; 0 decides and writes.
        size: Number of processes on all machines.
        local: Index on its machine, and of its GPU.
    """

    rank: int = 0
    size: int = 1
    local: int = 0

    @classmethod
    def of_environment(cls) -> ProcessGroup:
        """Read the group from torchrun's environment."""
        size = os.environ.get("WORLD_SIZE", "1")
        if size == "1":
            return cls()
        try:
            group = cls(*(int(os.environ[name]) for name in ("RANK", "WORLD_SIZE", "LOCAL_RANK")))
        except (KeyError, ValueError):
            group = cls(size=0)
        if not 0 <= group.rank < group.size or group.local < 0:
            raise InputError(
                f"WORLD_SIZE is {size!r} without RANK and LOCAL_RANK; start with torchrun, or unset "
                "WORLD_SIZE"
            )
        return group

    @property
    def first(self) -> bool:
        return self.rank == 0

    def join(self) -> None:
        if self.size == 1:
            return
        import torch
        from torch import distributed

        if distributed.is_initialized():
            return
        backend = "cpu:gloo,cuda:nccl" if torch.cuda.is_available() else "gloo"
        distributed.init_process_group(backend, timeout=PATIENCE)
        atexit.register(distributed.destroy_process_group)

    def wait(self) -> None:
        self.sum(0.0)

    def sum(self, number: float) -> float:
        """Return the sum of a number over all processes."""
        return self._collect(number, total=True)

    def first_says(self, number: float) -> float:
        """Return the first process's number in all processes."""
        return self._collect(number, total=False)

    def _collect(self, number: float, *, total: bool) -> float:
        if self.size == 1:
            return number
        import torch
        from torch import distributed

        self.join()
        value = torch.tensor(number, dtype=torch.float64)
        if total:
            distributed.all_reduce(value)
        else:
            distributed.broadcast(value, 0)
        return float(value)

    def share(self, rows: Indices) -> tuple[Indices, float]:
        """Return this process's rows of a batch and their weight; small batches go to all."""
        if len(rows) < 2 * self.size:
            return rows, 1.0
        mine = rows[self.rank :: self.size]
        return mine, self.size * len(mine) / len(rows)

    def device(self) -> torch.device:
        """Return the CPU, or the GPU of this process."""
        import torch

        if not torch.cuda.is_available():
            return torch.device("cpu")
        if self.local >= torch.cuda.device_count():
            raise InputError(
                f"process {self.local + 1} on a machine of {torch.cuda.device_count()} GPUs; reduce "
                "--nproc-per-node",
                code="gpu-count",
            )
        return torch.device("cuda", self.local) if self.size > 1 else torch.device("cuda")

    def with_shared_statistics(self, network: nn.Module) -> nn.Module:
        """Return the network, on several GPUs with batch statistics of all shares."""
        import torch

        if self.size == 1 or not torch.cuda.is_available():
            return network
        return torch.nn.SyncBatchNorm.convert_sync_batchnorm(deepcopy(network))

    def spread(self, network: nn.Module, device: torch.device) -> nn.Module:
        """Return the network with the first's weights and averaged gradients."""
        if self.size == 1:
            return network
        from torch.nn.parallel import DistributedDataParallel

        return DistributedDataParallel(network, device_ids=[device] if device.type == "cuda" else None)

    def align(self, network: nn.Module) -> None:
        """Give all processes the first's weights and statistics; the network is on the CPU."""
        if self.size == 1:
            return
        from torch import distributed

        for value in network.state_dict().values():
            distributed.broadcast(value, 0)

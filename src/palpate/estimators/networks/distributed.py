"""The processes that torchrun began, which train one network: each learns from its share of every batch.

They know of each other from torchrun's environment (RANK, LOCAL_RANK, WORLD_SIZE); without it there is one.
torch is imported only where processes are to meet, so that which one this is can be asked without it. Numbers
and waiting go through gloo, gradients through NCCL where there are GPUs; nothing is pickled.
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

PATIENCE = timedelta(days=1)
"""Of one that waits: the first may pack a long recording. Where one fails, torchrun ends them all at once."""


@dataclass(frozen=True, slots=True)
class ProcessGroup:
    """The processes that work together, as one of them sees them.

    Attributes:
        rank: which this is; the first, 0, is the one that decides and writes.
        size: how many there are, on all machines.
        local: which this is on its machine, and so which GPU it takes.
    """

    rank: int = 0
    size: int = 1
    local: int = 0

    @classmethod
    def of_environment(cls) -> ProcessGroup:
        """Read the group from the environment that torchrun sets.

        Raises:
            InputError: WORLD_SIZE is set and what goes with it is not.
        """
        size = os.environ.get("WORLD_SIZE", "1")
        if size == "1":
            return cls()
        try:
            group = cls(*(int(os.environ[name]) for name in ("RANK", "WORLD_SIZE", "LOCAL_RANK")))
        except (KeyError, ValueError):
            group = cls(size=0)
        if not 0 <= group.rank < group.size or group.local < 0:
            raise InputError(
                f"WORLD_SIZE is {size!r}, and RANK and LOCAL_RANK do not say which process this is; begin "
                "several by torchrun, or unset WORLD_SIZE to train by one"
            )
        return group

    @property
    def first(self) -> bool:
        """True for the process that decides and writes."""
        return self.rank == 0

    def join(self) -> None:
        """Meet the others; once in a process."""
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
        """Wait until all others have come here too."""
        self.sum(0.0)

    def sum(self, number: float) -> float:
        """Sum of the numbers of all processes; the same in all."""
        return self._collect(number, total=True)

    def first_says(self, number: float) -> float:
        """Number of the first process, in all; those of the others are not looked at."""
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
        """This process's rows of a batch, and the weight of their mean loss in the mean of all shares.

        Too few rows for two each are learnt from by every process alike.
        """
        if len(rows) < 2 * self.size:
            return rows, 1.0
        mine = rows[self.rank :: self.size]
        return mine, self.size * len(mine) / len(rows)

    def device(self) -> torch.device:
        """The processor or the GPU that is this process's own.

        Raises:
            InputError: there are GPUs, but fewer than processes on this machine.
        """
        import torch

        if not torch.cuda.is_available():
            return torch.device("cpu")
        if self.local >= torch.cuda.device_count():
            raise InputError(
                f"this is process {self.local + 1} of its machine, which has {torch.cuda.device_count()} "
                "GPUs; give torchrun --nproc-per-node as many or fewer",
                code="gpu-count",
            )
        return torch.device("cuda", self.local) if self.size > 1 else torch.device("cuda")

    def with_shared_statistics(self, network: nn.Module) -> nn.Module:
        """The network itself, or on several GPUs a copy whose batch statistics are those of all shares.

        torch has no such batch normalisation on the CPU: there each process normalises by its own share.
        """
        import torch

        if self.size == 1 or not torch.cuda.is_available():
            return network
        return torch.nn.SyncBatchNorm.convert_sync_batchnorm(deepcopy(network))

    def spread(self, network: nn.Module, device: torch.device) -> nn.Module:
        """The network, from the first's weights, with gradients that are the mean of all processes'."""
        if self.size == 1:
            return network
        from torch.nn.parallel import DistributedDataParallel

        return DistributedDataParallel(network, device_ids=[device] if device.type == "cuda" else None)

    def align(self, network: nn.Module) -> None:
        """Give all processes the first's weights and statistics; the network lies on the CPU."""
        if self.size == 1:
            return
        from torch import distributed

        for value in network.state_dict().values():
            distributed.broadcast(value, 0)

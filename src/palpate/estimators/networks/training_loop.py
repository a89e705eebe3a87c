"""Training loop of the larger networks: Adam on batches, clipped gradients, and checkpoints.

Randomness follows from the seed and the epoch, and checkpoints are plain arrays, so that interrupted training
resumes to the same weights on the same machine and threads. bfloat16 is used for passes where it is fast;
weights and loss stay float32.

Reference for Adam: Kingma & Ba, ICLR (2015), arXiv:1412.6980.
"""

from __future__ import annotations

import math
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palpate.core import Float32, Indices, InputError, Progress, Tensor, silent
from palpate.core.optional_imports import optional_imports
from palpate.estimators.networks.compact_cnn import (
    checkpoint_part,
    cosine_rate,
    fast_bfloat16,
    optimiser_states,
    read_checkpoint,
    write_checkpoint,
)
from palpate.estimators.networks.model_interface import TrainingRecord

with optional_imports("A network"):
    import torch
    from torch import nn

Loss = Callable[[torch.Tensor, torch.Tensor], torch.Tensor]
Vary = Callable[[Tensor, tuple[int, ...]], Tensor]
PRECISIONS = ("auto", "float32")
WATCHED_AT_ONCE = 64
RISING = 100  # steps
FALL = 0.3  # of Adam's step, where the watched rows gain no more


@dataclass(frozen=True)
class TrainingTask:
    """Rows, targets, and loss of a training.

    Attributes:
        fetch: Function from rows to inputs ``[n c h w]``.
        wanted: Targets of every row that can be fetched.
        loss: Mean loss over rows of outputs ``[n t]``.
        learn: Training rows.
        watch: Rows for early stopping; none to train to the last epoch.
        vary: Augmentation of an input ``[1 c h w]`` by a seed, for training rows only.
    """

    fetch: Callable[[Indices], Tensor]
    wanted: Float32[np.ndarray, "n t"]
    loss: Loss
    learn: Indices
    watch: Indices
    vary: Vary | None = None


@dataclass(frozen=True, slots=True)
class TrainingLoop:
    """Training schedule.

    Attributes:
        epochs: Greatest number of passes.
        batch: Rows a step; a last batch of one row is omitted.
        learning_rate: Adam's step.
        patience: Epochs without a smaller loss on watched rows before it stops; the best weights are kept.
        precision: "auto" uses bfloat16 where it is fast, "float32" never.
        clip: Greatest norm of the gradient.
        cosine: Warm up over a hundred steps, then decay along a cosine.
        falls: Number of times that, instead of stopping, it resumes from the best epoch with 0.3 times the
            step.
        steps: Adam steps in all; 0 for as many as the epochs have.
    """

    epochs: int
    batch: int = 32
    learning_rate: float = 1e-3
    patience: int = 0
    precision: str = "auto"
    clip: float = 5.0
    cosine: bool = False
    falls: int = 0
    steps: int = 0

    def __post_init__(self) -> None:
        if self.epochs < 1 or self.batch < 2 or min(self.patience, self.falls, self.steps) < 0:
            raise InputError(
                f"epochs {self.epochs}, batch {self.batch}, patience {self.patience}, falls {self.falls}, "
                f"steps {self.steps}; allowed: 1, 2, 0, 0, 0 or more",
                code="epoch-count",
            )
        if not (0 < self.learning_rate < math.inf and self.clip > 0):
            raise InputError(
                f"learning_rate {self.learning_rate}, clip {self.clip}; above 0", code="learning-rate"
            )
        if self.precision not in PRECISIONS:
            raise InputError(f"precision {self.precision!r} ; give auto or float32", code="precision")

    def steps_in_all(self, steps_an_epoch: int) -> int:
        return self.steps or self.epochs * steps_an_epoch

    def rate(self, step: int, steps_an_epoch: int) -> float:
        """Return Adam's step at a step number, before reductions."""
        if not self.cosine:
            return self.learning_rate
        total = self.steps_in_all(steps_an_epoch)
        return cosine_rate(self.learning_rate, step, total, min(RISING, total))

    def train(
        self,
        network: nn.Module,
        task: TrainingTask,
        *,
        seed: int,
        progress: Progress = silent,
        checkpoint: Path | None = None,
    ) -> nn.Module:
        """Train a network, and return it on the CPU in evaluation mode; see `run`."""
        return self.run(network, task, seed=seed, progress=progress, checkpoint=checkpoint).kept()

    def run(
        self,
        network: nn.Module,
        task: TrainingTask,
        *,
        seed: int,
        progress: Progress = silent,
        checkpoint: Path | None = None,
    ) -> TrainingRun:
        """Train a network in place to the schedule's end.

        Args:
            network: Map from inputs to outputs.
            task: Rows and loss.
            seed: Seed of the order of rows.
            progress: Progress callback.
            checkpoint: File to resume from.
        """
        if len(task.learn) < 2:
            raise InputError(f"{len(task.learn)} rows; give 2 or more", code="too-few-rows")
        run = TrainingRun(self, network, task, seed)
        if checkpoint is not None and checkpoint.exists():
            run.load(checkpoint)
        while not run.ended:
            run.one_epoch()
            if checkpoint is not None:
                run.save(checkpoint)
            progress("learning", run.epoch, run.epochs)
        progress("learning", run.epochs, run.epochs)
        return run


class TrainingRun:
    """Network in training with its optimizer and its best state."""

    def __init__(self, plan: TrainingLoop, network: nn.Module, task: TrainingTask, seed: int) -> None:
        self.plan, self.task, self.seed, self.epoch, self.step, self.falls = plan, task, seed, 0, 0, 0
        each = len(_batches(task.learn, plan.batch))
        self.steps = plan.steps_in_all(each)
        self.epochs = math.ceil(self.steps / each)
        self.device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
        self.network = network.to(self.device, memory_format=torch.channels_last)
        self.optimiser = torch.optim.Adam(self.network.parameters(), lr=plan.learning_rate)
        self.best: dict[str, torch.Tensor] = {}
        self.best_loss, self.best_step, self.since = math.inf, 0, 0

    @property
    def stops_early(self) -> bool:
        return self.plan.patience > 0 and len(self.task.watch) > 0

    @property
    def stopped(self) -> bool:
        """Whether watched rows gain no more at the smallest step."""
        return self.stops_early and self.since >= self.plan.patience and self.falls >= self.plan.falls

    @property
    def ended(self) -> bool:
        return self.step >= self.steps or self.stopped

    @property
    def record(self) -> TrainingRecord:
        return TrainingRecord(self.step, self.epoch, self.plan.batch, self.best_step, self.stopped)

    def one_epoch(self) -> None:
        """Train on every row once, then evaluate the watched rows."""
        rng = np.random.default_rng([self.seed, self.epoch])
        order = rng.permutation(self.task.learn)
        self.network.train()
        parts = _batches(order, self.plan.batch)
        taken = parts[: self.steps - self.step]
        losses = [self._step(part, (self.step + i, len(parts))) for i, part in enumerate(taken)]
        self.epoch, self.step = self.epoch + 1, self.step + len(taken)
        self._require_a_number(torch.stack(losses).sum().item())
        if self.stops_early:
            self._remember(self.watched_loss())

    def _step(self, part: Indices, at: tuple[int, int]) -> torch.Tensor:
        """Take the `at[0]`-th of `at[1]` steps of an epoch."""
        for group in self.optimiser.param_groups:
            group["lr"] = self.plan.rate(*at) * FALL**self.falls
        with torch.autocast(self.device.type, dtype=torch.bfloat16, enabled=self._uses_bfloat16()):
            answer = self.network(self._on_device(self._varied(part, at[0])))
        loss = self.task.loss(answer.float(), self._wanted(part))
        self.optimiser.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(self.network.parameters(), self.plan.clip)
        self.optimiser.step()
        return loss.detach()

    def _varied(self, part: Indices, step: int) -> Tensor:
        """Inputs changed by seeds that depend on the row and the step."""
        inputs, vary = self.task.fetch(part), self.task.vary
        if vary is None:
            return inputs
        each = zip(inputs, part.tolist(), strict=True)
        return np.concatenate([vary(image[None], (self.seed, step, row)) for image, row in each])

    def _inputs(self, part: Indices) -> torch.Tensor:
        return self._on_device(self.task.fetch(part))

    def _on_device(self, inputs: Tensor) -> torch.Tensor:
        return torch.from_numpy(inputs).to(self.device).contiguous(memory_format=torch.channels_last)

    def _wanted(self, part: Indices) -> torch.Tensor:
        return torch.from_numpy(self.task.wanted[part]).to(self.device)

    def _uses_bfloat16(self) -> bool:
        if self.plan.precision == "float32":
            return False
        return torch.cuda.is_bf16_supported() if self.device.type == "cuda" else fast_bfloat16()

    def watched_loss(self) -> float:
        """Return the loss of the watched rows in float32."""
        watch = self.task.watch
        self.network.eval()
        with torch.no_grad():
            parts = [watch[i : i + WATCHED_AT_ONCE] for i in range(0, len(watch), WATCHED_AT_ONCE)]
            answers = torch.cat([self.network(self._inputs(part)).float() for part in parts])
            return float(self.task.loss(answers, self._wanted(watch)))

    def _remember(self, loss: float) -> None:
        self._require_a_number(loss)
        if loss < self.best_loss:
            self.best = {k: v.detach().cpu().clone() for k, v in self.network.state_dict().items()}
            self.best_loss, self.best_step, self.since = loss, self.step, 0
            return
        self.since += 1
        if self.since >= self.plan.patience and self.falls < self.plan.falls:
            self.network.load_state_dict(self.best)
            self.falls, self.since = self.falls + 1, 0

    def _require_a_number(self, loss: float) -> None:
        if not math.isfinite(loss):
            raise InputError(
                f"the loss is {loss} in epoch {self.epoch}; check the labels, or take a learning_rate below "
                f"{self.plan.learning_rate:g}",
                code="loss-not-finite",
            )

    def kept(self) -> nn.Module:
        """Return the best network, or the last one if none was watched, on the CPU."""
        if self.best:
            self.network.load_state_dict(self.best)
        return self.network.to("cpu", memory_format=torch.contiguous_format).eval()

    def save(self, path: Path) -> None:
        counts = {name: getattr(self, name) for name in ("seed", *COUNTS, "best_loss")}
        states = {"network": self.network.state_dict(), "best": self.best}
        write_checkpoint(path, counts, states, self.optimiser)

    def load(self, path: Path) -> None:
        """Load a checkpoint; a damaged or foreign file is renamed."""
        try:
            self._take(read_checkpoint(path))
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error):
            path.replace(path.with_suffix(".damaged"))

    def _take(self, arrays: dict[str, torch.Tensor]) -> None:
        """Take all of a checkpoint's arrays, or none."""
        network, best = checkpoint_part(arrays, "network"), checkpoint_part(arrays, "best")
        self._require_fit(network)
        if best:
            self._require_fit(best)
        states = {
            i: {name: _laid_out(value) for name, value in state.items()}
            for i, state in optimiser_states(arrays).items()
        }
        whole = states.keys() == set(range(len(list(self.network.parameters()))))
        if not (whole and all(set(state) == {"step", "exp_avg", "exp_avg_sq"} for state in states.values())):
            raise ValueError("the optimiser's state is not whole")
        if int(arrays["seed"]) != self.seed:
            raise ValueError("the checkpoint is of another seed")
        counts, best_loss = {name: int(arrays[name]) for name in COUNTS}, float(arrays["best_loss"])
        self.network.load_state_dict(network)
        self.optimiser.load_state_dict(self.optimiser.state_dict() | {"state": states})
        self.best, self.best_loss = best, best_loss
        for name, count in counts.items():
            setattr(self, name, count)

    def _require_fit(self, weights: dict[str, torch.Tensor]) -> None:
        shapes = {k: v.shape for k, v in self.network.state_dict().items()}
        if {k: v.shape for k, v in weights.items()} != shapes:
            raise ValueError("the weights are of another network")


COUNTS = ("epoch", "step", "falls", "best_step", "since")


def _batches(rows: Indices, size: int) -> list[Indices]:
    """Batches of rows; a last one of one row is omitted."""
    parts = [rows[i : i + size] for i in range(0, len(rows), size)]
    return [part for part in parts if len(part) > 1]


def _laid_out(state: torch.Tensor) -> torch.Tensor:
    """State in the memory layout of its weights, so that steps are computed in the same order."""
    return state.contiguous(memory_format=torch.channels_last) if state.dim() == 4 else state

"""The training loop goes on where it was, keeps the best, and refuses what cannot be learnt."""

from dataclasses import replace

import numpy as np
import pytest
from tests.refusals import refused

from palpate.core.errors import InputError

torch = pytest.importorskip("torch", reason="the extra `train` is not installed")

from torch import nn  # noqa: E402

from palpate.estimators.networks.training_loop import TrainingLoop, TrainingRun, TrainingTask  # noqa: E402


class Interrupted(Exception):
    pass


def small_network() -> nn.Module:
    torch.manual_seed(7)
    convolution = nn.Conv2d(3, 8, 3, stride=2, padding=1)
    return nn.Sequential(
        convolution, nn.BatchNorm2d(8), nn.ReLU(), nn.AdaptiveAvgPool2d(2), nn.Flatten(), nn.Linear(32, 2)
    )


def levels(rng: np.random.Generator, n: int = 48, noise: bool = False) -> TrainingTask:
    """The mean and the tilt of an image; the last quarter of the rows is watched."""
    images = rng.normal(0, 1, (n, 3, 8, 8)).astype(np.float32) + rng.normal(0, 1, (n, 1, 1, 1)).astype("f4")
    wanted = np.stack([images.mean((1, 2, 3)), images[..., :4].mean((1, 2, 3))], axis=1)
    if noise:
        wanted = rng.normal(0, 1, wanted.shape)
    learn, watch = np.arange(3 * n // 4), np.arange(3 * n // 4, n)
    fetch = images.__getitem__
    return TrainingTask(fetch, wanted.astype(np.float32), nn.functional.mse_loss, learn, watch)


def same(first: nn.Module, second: nn.Module) -> bool:
    pairs = zip(first.state_dict().values(), second.state_dict().values(), strict=True)
    return all(torch.equal(a, b) for a, b in pairs)


def stop_after(epoch: int):
    def told(what: str, done: int, total: int) -> None:
        if done == epoch:
            raise Interrupted

    return told


def brighter(image: np.ndarray, seed: tuple[int, ...]) -> np.ndarray:
    return image + np.random.default_rng(seed).normal(0, 1, (1, 1, 1, 1)).astype(np.float32)


def test_varied_inputs_are_learnt_from_with_a_seed_of_their_own_and_watched_ones_stay(rng) -> None:
    lesson, seeds = levels(rng), []

    def noted(image: np.ndarray, seed: tuple[int, ...]) -> np.ndarray:
        seeds.append(seed)
        return brighter(image, seed)

    varied = replace(lesson, vary=noted)
    plan = TrainingLoop(4, 8, 1e-2, 0, "float32")
    first = plan.train(small_network(), varied, seed=5)
    assert len(set(seeds)) == len(seeds) == 4 * 36  # rows, once an epoch
    assert {row for _, _, row in seeds} == set(lesson.learn.tolist())
    assert same(first, plan.train(small_network(), replace(lesson, vary=brighter), seed=5))
    assert not same(first, plan.train(small_network(), lesson, seed=5))
    run = TrainingRun(plan, small_network(), varied, 5)
    assert run.watched_loss() == TrainingRun(plan, small_network(), lesson, 5).watched_loss()


@pytest.mark.parametrize(("patience", "vary"), [(0, brighter), (3, None)])
def test_interrupted_and_resumed_it_reaches_the_same_weights(rng, tmp_path, patience, vary) -> None:
    lesson, plan = replace(levels(rng), vary=vary), TrainingLoop(5, 8, 1e-2, patience)
    whole = plan.train(small_network(), lesson, seed=5)
    kept = tmp_path / "kept.npz"
    for epoch in (2, 4):
        with pytest.raises(Interrupted):
            plan.train(small_network(), lesson, seed=5, progress=stop_after(epoch), checkpoint=kept)
    resumed = plan.train(small_network(), lesson, seed=5, checkpoint=kept)
    assert same(whole, resumed)
    assert not same(whole, plan.train(small_network(), lesson, seed=6))
    assert [path.name for path in tmp_path.iterdir()] == ["kept.npz"]


@pytest.mark.parametrize("damage", ["cut", "no archive", "another network", "another seed"])
def test_a_damaged_checkpoint_is_set_aside_and_begun_anew(rng, tmp_path, damage: str) -> None:
    lesson, plan, kept = levels(rng), TrainingLoop(3, 8, 1e-2, 2), tmp_path / "kept.npz"
    whole = plan.train(small_network(), lesson, seed=5)
    plan.train(small_network(), lesson, seed=5 + (damage == "another seed"), checkpoint=kept)
    held = dict(np.load(kept))
    if damage == "cut":
        kept.write_bytes(kept.read_bytes()[:-500])
    elif damage == "no archive":
        kept.write_bytes(b"PK not a checkpoint")
    elif damage == "another network":
        np.savez(kept, **held | {"network/0.weight": np.zeros((8, 1, 3, 3), np.float32)})
    assert same(whole, plan.train(small_network(), lesson, seed=5, checkpoint=kept))
    assert (tmp_path / "kept.damaged").exists()
    assert int(np.load(kept)["epoch"]) == 3


def test_a_full_disk_leaves_the_last_whole_checkpoint(rng, tmp_path, monkeypatch) -> None:
    lesson, plan, kept = levels(rng), TrainingLoop(3, 8, 1e-2), tmp_path / "kept.npz"
    with pytest.raises(Interrupted):
        plan.train(small_network(), lesson, seed=5, progress=stop_after(1), checkpoint=kept)

    def full(file, **arrays: object) -> None:
        file.write(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez", full)
    with pytest.raises(OSError, match="No space"):
        plan.train(small_network(), lesson, seed=5, checkpoint=kept)
    assert [path.name for path in tmp_path.iterdir()] == ["kept.npz"]
    assert int(np.load(kept)["epoch"]) == 1


def test_a_budget_of_steps_is_kept_to_the_step_whatever_the_epochs(rng, tmp_path) -> None:
    lesson, kept = levels(rng), tmp_path / "kept.npz"  # 36 rows to learn from: 5 steps an epoch
    plan = TrainingLoop(1, 8, 1e-2, steps=13)
    run = plan.run(small_network(), lesson, seed=5)
    assert (run.record.steps, run.record.epochs, run.record.stopped) == (13, 3, False)
    assert int(run.optimiser.state_dict()["state"][0]["step"]) == 13
    with pytest.raises(Interrupted):
        plan.train(small_network(), lesson, seed=5, progress=stop_after(2), checkpoint=kept)
    assert same(plan.train(small_network(), lesson, seed=5, checkpoint=kept), run.kept())
    by_epochs = TrainingLoop(2, 8, 1e-2).run(small_network(), lesson, seed=5)
    assert same(by_epochs.kept(), TrainingLoop(7, 8, 1e-2, steps=10).train(small_network(), lesson, seed=5))


def test_where_watched_rows_gain_no_more_the_step_falls_from_the_best_weights(rng, monkeypatch) -> None:
    lesson, rates = levels(rng, noise=True), []
    step = TrainingRun._step

    def noted(self: TrainingRun, *given: object) -> torch.Tensor:
        loss = step(self, *given)
        rates.append(self.optimiser.param_groups[0]["lr"])
        return loss

    monkeypatch.setattr(TrainingRun, "_step", noted)
    run = TrainingLoop(100, 8, 3e-2, patience=3, falls=2).run(small_network(), lesson, seed=1)
    assert sorted(set(rates), reverse=True) == pytest.approx([3e-2, 9e-3, 2.7e-3])
    assert run.record.stopped
    assert run.record.steps == len(rates) < 100 * 5
    assert 0 < run.record.best_step <= run.record.steps - 3 * 5
    shorter = TrainingLoop(100, 8, 3e-2, patience=3).run(small_network(), lesson, seed=1)
    assert shorter.record.steps < run.record.steps
    assert run.best_loss <= shorter.best_loss  # the best is never given up


def test_it_stops_when_watched_rows_gain_no_more_and_keeps_the_best(rng, monkeypatch) -> None:
    lesson, seen, told = levels(rng, noise=True), [], []
    watched = TrainingRun.watched_loss

    def noted(self: TrainingRun) -> float:
        seen.append(watched(self))
        return seen[-1]

    monkeypatch.setattr(TrainingRun, "watched_loss", noted)
    plan = TrainingLoop(60, 8, 3e-2, patience=4)
    kept = plan.train(small_network(), lesson, seed=1, progress=lambda what, done, total: told.append(done))
    # Labels that are noise: the watched loss soon stops falling.
    assert len(seen) < 40
    assert len(seen) - 1 - np.argmin(seen) == 4
    assert told[-1] == 60
    with torch.no_grad():
        answer = kept(torch.from_numpy(lesson.fetch(lesson.watch)))
    loss = nn.functional.mse_loss(answer, torch.from_numpy(lesson.wanted[lesson.watch]))
    # The layout in memory differs, and so the order of summation.
    np.testing.assert_allclose(loss.item(), min(seen), rtol=1e-5)


def test_a_long_gradient_is_shortened_to_a_norm_of_five(rng) -> None:
    lesson = levels(rng)
    steep = replace(lesson, loss=lambda answer, wanted: 1e6 * nn.functional.mse_loss(answer, wanted))
    run = TrainingRun(TrainingLoop(1, 36, precision="float32"), small_network(), steep, seed=0)
    run.one_epoch()
    moments = [state["exp_avg"] for state in run.optimiser.state.values()]
    norm = torch.sqrt(sum((m**2).sum() for m in moments)).item()
    # Adam's first moment after one step is a tenth of the gradient.
    np.testing.assert_allclose(norm, 0.5, rtol=1e-3)


def test_every_row_is_seen_once_an_epoch_but_a_last_one_alone(rng) -> None:
    lesson, seen = replace(levels(rng), learn=np.arange(25)), []
    fetch = lesson.fetch
    noted = replace(lesson, fetch=lambda rows: (seen.append(rows), fetch(rows))[1])
    TrainingLoop(2, 8).train(small_network(), noted, seed=0)
    assert [len(rows) for rows in seen] == [8, 8, 8] * 2
    assert len(set(np.concatenate(seen[:3]))) == 24
    assert list(np.concatenate(seen[:3])) != list(np.concatenate(seen[3:]))


def test_labels_that_are_no_numbers_and_a_single_row_are_refused(rng) -> None:
    lesson = levels(rng)
    with refused("too-few-rows", InputError):
        TrainingLoop(2, 8).train(small_network(), replace(lesson, learn=np.arange(1)), seed=0)
    lesson.wanted[3] = np.nan
    with refused("loss-not-finite", InputError):
        TrainingLoop(2, 8).train(small_network(), lesson, seed=0)


def test_settings_that_train_nothing_are_refused() -> None:
    nan = float("nan")
    for name, value in {"epochs": 0, "batch": 1, "patience": -1, "learning_rate": nan, "clip": -5.0}.items():
        with pytest.raises(InputError):
            TrainingLoop(**{"epochs": 3} | {name: value})

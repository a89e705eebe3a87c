"""Two processes train as one does: the same weights, exactly resumed, and only the first writes.

Run as a script, this file is one of the processes that the tests begin.
"""

import os
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from palpate.core.errors import InputError

torch = pytest.importorskip("torch", reason="the extra `train` is not installed")

from torch import nn  # noqa: E402

from palpate.estimators.networks.distributed import ProcessGroup  # noqa: E402
from palpate.estimators.networks.training_loop import TrainingLoop, TrainingRun, TrainingTask  # noqa: E402

TIMEOUT_S = 240  # for all that several processes do; alone on a core they take some 20 s
# Batches of 9 are shared unevenly, and 30 rows leave a last one of 3: too few for two rows each, so both
# learn from all of it.
ROWS, LEARN, BATCH, EPOCHS = 42, 30, 9, 4
SHARED = 10  # of which every batch is shared, so that each process ends with statistics of its own


def network(normalised: bool = False) -> nn.Module:
    torch.manual_seed(7)
    convolution = nn.Conv2d(3, 8, 3, stride=2, padding=1)
    middle = nn.BatchNorm2d(8) if normalised else nn.Identity()
    pooled = nn.Sequential(nn.AdaptiveAvgPool2d(2), nn.Flatten())
    head = nn.Sequential(nn.Linear(32, 24), nn.Tanh(), nn.Linear(24, 2))
    return nn.Sequential(convolution, middle, nn.ReLU(), *pooled, *head)


def lesson(noise: bool = False) -> TrainingTask:
    rng = np.random.default_rng(3)
    images = rng.normal(0, 1, (ROWS, 3, 8, 8)).astype(np.float32)
    wanted = np.stack([images.mean((1, 2, 3)), images[..., :4].mean((1, 2, 3))], axis=1)
    wanted = rng.normal(0, 1, wanted.shape) if noise else 5 * wanted

    learn, watch = np.arange(LEARN), np.arange(LEARN, ROWS)
    return TrainingTask(images.__getitem__, wanted.astype(np.float32), nn.functional.mse_loss, learn, watch)


def plan(patience: int = 0, epochs: int = EPOCHS, batch: int = BATCH) -> TrainingLoop:
    return TrainingLoop(epochs, batch, 1e-2, patience, "float32")


def weights(trained: nn.Module) -> dict[str, np.ndarray]:
    return {name: value.numpy() for name, value in trained.state_dict().items()}


def trainings(folder: Path) -> dict[str, nn.Module]:
    """What both processes, and one alone, are asked to train; checkpoints go into the folder."""
    return {
        "plain": plan().train(network(), lesson(), seed=5),
        "normalised": plan(batch=SHARED).train(network(normalised=True), lesson(), seed=5),
        "early": plan(patience=2, epochs=30).train(network(), lesson(noise=True), seed=5),
        "plain-resumed": resumed(folder / "plain.npz", False),
        "normalised-resumed": resumed(folder / "normalised.npz", True, SHARED),
    }


def resumed(checkpoint: Path, normalised: bool, batch: int = BATCH) -> nn.Module:
    """Trained to half, and then on by a run that knows nothing but the checkpoint."""
    before = TrainingRun(plan(batch=batch), network(normalised), lesson(), 5)
    for _ in range(EPOCHS // 2):
        before.one_epoch()
    if before.processes.first:
        before.save(checkpoint)
    return plan(batch=batch).train(network(normalised), lesson(), seed=5, checkpoint=checkpoint)


def free_port() -> int:
    with socket.socket() as held:
        held.bind(("127.0.0.1", 0))
        return held.getsockname()[1]


def begin(size: int, folder: Path, task: str) -> list[tuple[int, str]]:
    """Run this file as `size` processes, as torchrun would begin them; how each ended, and what it said."""
    port, begun = free_port(), []
    (folder / "shared").mkdir(exist_ok=True)
    for rank in range(size):
        own = {"RANK": rank, "LOCAL_RANK": rank, "WORLD_SIZE": size, "MASTER_PORT": port}
        env = os.environ | {name: str(value) for name, value in own.items()}
        env |= {"MASTER_ADDR": "127.0.0.1", "OMP_NUM_THREADS": "1", "CUDA_VISIBLE_DEVICES": ""}
        (folder / f"rank-{rank}").mkdir()
        command = [sys.executable, "-W", "error", __file__, task, str(folder)]
        begun.append(
            subprocess.Popen(command, env=env, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        )
    try:
        said = [process.communicate(timeout=TIMEOUT_S)[0] for process in begun]
        return [(process.returncode, text) for process, text in zip(begun, said, strict=True)]
    finally:
        for process in begun:
            process.kill()


def trained_by(size: int, folder: Path, task: str) -> list[dict[str, dict[str, np.ndarray]]]:
    """The weights that each process ended with, by what was trained."""
    for code, said in begin(size, folder, task):
        assert code == 0, said
    return [
        {path.stem: dict(np.load(path)) for path in (folder / f"rank-{rank}").glob("*.npz")}
        for rank in range(size)
    ]


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    """The weights of each of two processes, by what was trained."""
    return trained_by(2, tmp_path_factory.mktemp("two"), "train")


@pytest.fixture(scope="module")
def one(tmp_path_factory):
    """The same by this process alone, with one thread as they have."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield {name: weights(made) for name, made in trainings(tmp_path_factory.mktemp("one")).items()}
    torch.set_num_threads(threads)


@pytest.mark.slow
@pytest.mark.parametrize("which", ["plain", "early"])
def test_two_processes_train_the_weights_that_one_does(two, one, which: str) -> None:
    # The same steps but for the order of sums; Adam divides by a gradient's size, so small ones differ most.
    for name, value in one[which].items():
        np.testing.assert_allclose(two[0][which][name], value, atol=1e-5, rtol=0)
    moved = max(np.abs(value - weights(network())[name]).max() for name, value in one[which].items())
    assert moved > 1e-2, "training went somewhere"


@pytest.mark.slow
@pytest.mark.parametrize("which", ["plain", "normalised", "early", "plain-resumed", "normalised-resumed"])
def test_all_processes_end_with_the_same_weights(two, which: str) -> None:
    first, second = (found[which] for found in two)
    assert first.keys() == second.keys()
    assert all(np.array_equal(first[name], second[name]) for name in first)


@pytest.mark.slow
@pytest.mark.parametrize("which", ["plain", "normalised"])
def test_interrupted_and_resumed_two_processes_reach_the_same_weights(two, which: str) -> None:
    for name, value in two[0][which].items():
        np.testing.assert_array_equal(two[0][f"{which}-resumed"][name], value)


@pytest.mark.slow
def test_a_process_that_does_not_see_the_checkpoint_refuses(tmp_path) -> None:
    (first, _), (second, said) = begin(2, tmp_path, "unshared")
    assert (second, said.split()[-1]) == (3, "checkpoint-not-shared")
    assert first != 0, "the first, left alone, ends too"


def test_the_mean_of_weighted_shares_is_the_mean_of_the_batch(rng) -> None:
    for size, n in ((1, 5), (2, 3), (2, 9), (3, 6), (5, 9), (5, 32)):
        loss, rows = rng.normal(0, 1, n), np.arange(n)
        shares = [ProcessGroup(rank, size).share(rows) for rank in range(size)]
        np.testing.assert_allclose(np.mean([w * loss[mine].mean() for mine, w in shares]), loss.mean())
        assert min(len(mine) for mine, _ in shares) >= min(2, n)
        assert set(np.concatenate([mine for mine, _ in shares])) == set(rows)


def test_without_torchrun_there_is_one_process_that_waits_for_nobody(monkeypatch) -> None:
    monkeypatch.delenv("WORLD_SIZE", raising=False)
    processes = ProcessGroup.of_environment()
    assert processes == ProcessGroup(0, 1, 0)
    processes.join()
    processes.wait()
    assert processes.first
    assert processes.sum(2.5) == processes.first_says(2.5) == 2.5
    whole = network()
    assert processes.with_shared_statistics(whole) is whole
    assert processes.spread(whole, processes.device()) is whole


@pytest.mark.parametrize("wrong", [{}, {"RANK": "2"}, {"RANK": "first"}])
def test_an_environment_that_does_not_say_which_process_this_is_is_refused(monkeypatch, wrong) -> None:
    monkeypatch.delenv("RANK", raising=False)
    for name, value in ({"WORLD_SIZE": "2", "LOCAL_RANK": "0"} | wrong).items():
        monkeypatch.setenv(name, value)
    with pytest.raises(InputError, match="torchrun"):
        ProcessGroup.of_environment()


def test_a_batch_too_small_to_be_shared_is_refused_before_anyone_is_waited_for(monkeypatch) -> None:
    for name, value in {"WORLD_SIZE": "5", "RANK": "0", "LOCAL_RANK": "0"}.items():
        monkeypatch.setenv(name, value)
    with pytest.raises(InputError) as caught:
        plan().train(network(), lesson(), seed=0)
    assert caught.value.code == "batch-size"


def test_more_processes_than_gpus_are_refused_and_each_gets_its_own(monkeypatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    assert [str(ProcessGroup(rank, 2, rank).device()) for rank in range(2)] == ["cuda:0", "cuda:1"]
    with pytest.raises(InputError) as caught:
        ProcessGroup(2, 3, 2).device()
    assert caught.value.code == "gpu-count"


def test_on_gpus_a_copy_shares_its_batch_statistics_and_the_network_stays_as_it_is(monkeypatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    given = network(normalised=True)
    shared = ProcessGroup(0, 2).with_shared_statistics(given)
    assert isinstance(shared[1], nn.SyncBatchNorm)
    assert isinstance(given[1], nn.BatchNorm2d)
    assert shared.state_dict().keys() == given.state_dict().keys()


def small_recording(folder: Path) -> None:
    """A run of two views side by side, whose brightness tells the targets; each press begins untouched."""
    from palpate.recordings import Manifest, RunWriter

    rng, names = np.random.default_rng(0), ("depth_mm", "x_mm", "y_mm", "force_N")
    labels = {"press": "text", "reference": "flag"} | dict.fromkeys(names, "number")
    with RunWriter.create(folder, Manifest.new(sensor="views", labels=labels), overflow="wait") as writer:
        for press in range(8):
            for frame in range(4):
                values = rng.uniform(0, 1, 4) * (frame > 0)
                bands = np.repeat(100 * values, 16)[:, None]  # one a target, over both views
                image = rng.integers(0, 20, (32, 64, 3)) + bands
                held = dict(zip(names, values.tolist(), strict=True))
                writer.frame(
                    image.astype(np.uint8), labels={"press": f"{press}", "reference": frame == 0, **held}
                )


CALIBRATE = (
    "-m palpate.cli calibrate run --crop 0,0,32,32 --crop 32,0,32,32 --size 32x64 --folds 2 --scored-folds 2 "
    "--reference reference=true --reference-by press --split group:press --quiet"
)
COMPACT = (
    "--model palm-compact --option rendered=0 --option batch=8 --option epochs=6 --option precision=float32"
)


def under_torchrun(folder: Path, out: str, model: str = COMPACT) -> subprocess.Popen:
    env = os.environ | {"OMP_NUM_THREADS": "1", "CUDA_VISIBLE_DEVICES": ""}
    begin = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    command, pipe = [*begin, *CALIBRATE.split(), *model.split(), "--out", out], subprocess.PIPE
    return subprocess.Popen(command, cwd=folder, env=env, stdout=pipe, stderr=pipe, text=True)


@pytest.mark.slow
def test_palpate_calibrates_under_torchrun_once_and_goes_on_to_the_same_when_killed(tmp_path) -> None:
    small_recording(tmp_path / "run")
    said, complained = under_torchrun(tmp_path, "whole").communicate(timeout=TIMEOUT_S)
    assert said.count("calibration ") == 1, complained
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run", "whole"]

    stopped, work = under_torchrun(tmp_path, "again"), tmp_path / ".again.work"
    deadline = time.monotonic() + TIMEOUT_S
    while not (work / "fold-0.npy").exists() and time.monotonic() < deadline:
        time.sleep(0.01)
    stopped.terminate()
    stopped.communicate(timeout=TIMEOUT_S)
    assert work.exists(), "it was stopped on its way"
    assert not (tmp_path / "again").exists()
    under_torchrun(tmp_path, "again").communicate(timeout=TIMEOUT_S)
    first, second = ((tmp_path / name / "predictions.csv.gz").read_bytes() for name in ("whole", "again"))
    assert first == second
    assert sorted(path.name for path in tmp_path.iterdir()) == ["again", "run", "whole"]


@pytest.mark.slow
def test_a_model_that_trains_in_one_process_is_refused_under_torchrun(tmp_path) -> None:
    small_recording(tmp_path / "run")
    refused = under_torchrun(tmp_path, "cal", model="--model mean --targets force_N --json")
    assert "one-process" in refused.communicate(timeout=TIMEOUT_S)[0]
    assert refused.returncode != 0
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def one_of_many(task: str, folder: Path) -> dict[str, nn.Module]:
    """What one of the processes does."""
    rank, shared = ProcessGroup.of_environment().rank, folder / "shared"
    own = folder / f"rank-{rank}"
    if task == "unshared":
        return {"never": resumed(own / "plain.npz", False)}
    return trainings(shared)


def main(task: str, folder: Path) -> None:
    torch.set_num_threads(1)
    try:
        made = one_of_many(task, folder)
    except InputError as e:
        print(e.code)
        sys.exit(3)
    rank = ProcessGroup.of_environment().rank
    for name, trained in made.items():
        np.savez(folder / f"rank-{rank}" / f"{name}.npz", **weights(trained))


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))

"""A sweep gives the same results whoever works, says which item failed, and leaves nothing running."""

import importlib.util
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import pytest
from tests.refusals import refused

from palpate.core.errors import DeviceError, InputError, MissingExtraError, RangeError
from palpate.core.long_work import in_parallel
from palpate.workflows.parameter_sweep import sweep

HAS_DASK = importlib.util.find_spec("distributed") is not None
PATIENCE_S = 120  # for processes that begin on a busy machine


def mean_of_noise(spread: float, rng: np.random.Generator) -> float:
    return float(rng.normal(0, spread, 100).mean())


def picky(item: float) -> float:
    if item == 3.5:
        raise RangeError("3.5 mm is too deep")
    return item


def clumsy(item: float) -> float:
    return 1 / item


class TwoPartError(DeviceError):
    """Cannot be rebuilt from its message alone, as a process would have to."""

    def __init__(self, code: int, line: str) -> None:
        super().__init__(f"{line} gave {code}")


def rejects(item: float) -> float:
    raise TwoPartError(9, "G0")


def test_results_are_in_the_order_of_the_items_and_do_not_depend_on_the_processes() -> None:
    spreads = [2.0, 0.0, 1.0, 1.0, 5.0]
    alone, two = (sweep(mean_of_noise, spreads, seed=4, processes=n) for n in (1, 2))
    assert alone == two
    assert alone[1] == 0
    assert alone[2] != alone[3], "items that are alike have chance of their own"
    assert alone != sweep(mean_of_noise, spreads, seed=5)


def test_a_longer_sweep_begins_as_the_shorter_one() -> None:
    assert sweep(mean_of_noise, [1.0] * 5)[:3] == sweep(mean_of_noise, [1.0] * 3)


@pytest.mark.parametrize("processes", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_failing_job_names_its_item_and_an_expected_error_keeps_its_kind(processes: int) -> None:
    with refused("range", RangeError, match="item 2"):
        list(in_parallel(picky, [1.0, 2.0, 3.5, 4.0], processes=processes))
    with pytest.raises(RuntimeError, match=r"\(0\.0\): ZeroDivisionError"):
        list(in_parallel(clumsy, [1.0, 0.0], processes=processes))
    with refused("two-part", DeviceError, match="item 0"):
        list(in_parallel(rejects, [1.0, 2.0], processes=processes))


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"processes": 0}, "processes"),
        ({"processes": -1}, "processes"),
        ({"processes": 2, "scheduler": "tcp://127.0.0.1:1"}, "processes-and-scheduler"),
        ({"seed": -1}, "settings-range"),
    ],
)
def test_settings_that_nobody_could_work_by_are_refused(wrong: dict, says: str) -> None:
    with refused(says, InputError):
        sweep(mean_of_noise, [1.0], **wrong)


@pytest.mark.skipif(HAS_DASK, reason="Dask is installed")
def test_a_scheduler_without_dask_names_the_extra_to_install() -> None:
    with pytest.raises(MissingExtraError, match=r"palpate\[cluster\]"):
        sweep(mean_of_noise, [1.0], scheduler="tcp://127.0.0.1:8786")


SLEEPER = """
import sys, time
from pathlib import Path
from palpate.workflows.parameter_sweep import sweep

def slow(item, rng):
    Path(sys.argv[1], f"begun-{item}").touch()
    time.sleep(600)

sweep(slow, [0, 1, 2, 3], processes=2)
"""


@pytest.mark.slow
def test_ctrl_c_leaves_nothing_running(tmp_path: Path) -> None:
    code = SLEEPER.replace("sys.argv[1]", repr(str(tmp_path)))
    process = subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.PIPE, text=True)
    try:
        deadline = time.monotonic() + PATIENCE_S
        while len(list(tmp_path.iterdir())) < 2 and time.monotonic() < deadline:
            time.sleep(0.05)
        workers = psutil.Process(process.pid).children(recursive=True)
        assert len(workers) >= 2, "both had begun"
        # To the process alone: at a terminal all get it, but a job's scheduler tells one.
        os.kill(process.pid, signal.SIGINT)
        said = process.communicate(timeout=PATIENCE_S)[1]
        assert "KeyboardInterrupt" in said
        assert not psutil.wait_procs(workers, timeout=20)[1]
    finally:
        process.kill()
    assert len(list(tmp_path.iterdir())) == 2, "no job was begun after that"


@pytest.fixture(scope="module")
def scheduler():
    distributed = pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        yield cluster.scheduler_address


def test_a_cluster_gives_what_one_process_does(scheduler) -> None:
    told = []
    found = sweep(mean_of_noise, [1.0, 2.0, 3.0], scheduler=scheduler, progress=lambda *at: told.append(at))
    assert found == sweep(mean_of_noise, [1.0, 2.0, 3.0])
    assert told == [(1, 3), (2, 3), (3, 3)]


def test_a_job_that_fails_on_a_cluster_names_its_item(scheduler) -> None:
    with pytest.raises(RangeError, match=r"\(3\.5\)"):
        list(in_parallel(picky, [1.0, 3.5], scheduler=scheduler))


@pytest.mark.skipif(not HAS_DASK, reason="the extra `cluster` is not installed")
def test_an_address_where_no_scheduler_answers_is_refused(monkeypatch) -> None:
    monkeypatch.setattr("palpate.core.long_work.CONNECT_WITHIN", "1s")
    with refused("no-scheduler", InputError, match="tcp://127"):
        sweep(mean_of_noise, [1.0], scheduler="tcp://127.0.0.1:1")

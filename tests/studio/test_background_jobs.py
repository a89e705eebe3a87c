"""Jobs run beside the server, say how far they are, are bounded, and end with it."""

import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed")

from tests.refusals import refused

from palpate.core import InputError
from palpate.studio.library.background_jobs import MAX_RUNNING, BackgroundJobs
from palpate.studio.library.calibrations_page import job_html

STEPS = """
import json, sys, time
print(json.dumps({"progress": ["scoring", 3, 9]}), flush=True)
print("a library's own words", flush=True)
open(sys.argv[-1], "w").write("<p>made</p>")
if sys.argv[1] == "waits": time.sleep(60)
if sys.argv[1] == "fails": print(json.dumps({"error": "<b> is wrong"})); sys.exit(2)
if sys.argv[1] == "dies": sys.exit("Traceback: no memory")
print(json.dumps({"done": {"text": "found <i>"}}))
"""


@pytest.fixture
def jobs():
    with BackgroundJobs((sys.executable, "-c", STEPS)) as jobs:
        yield jobs


def until(job, *states):
    end_s = time.monotonic() + 20
    while job.state not in states and time.monotonic() < end_s:
        time.sleep(0.02)
    return job


def test_a_job_says_how_far_it_is_and_what_it_found(jobs):
    job = until(jobs.begin("Scores", "does", Path("x"), suffix=".html"), "done")
    assert (job.state, job.step, job.done, job.total) == ("done", "scoring", 3, 9)
    assert job.out.read_text() == "<p>made</p>"
    assert "found &lt;i&gt;" in job_html(job)
    assert jobs.get(job.number) is job
    assert jobs.get(99) is None


def test_a_job_that_is_refused_or_dies_says_why(jobs):
    refused = until(jobs.begin("x", "fails", suffix=".html"), "failed")
    assert "<b>" in refused.why
    assert "&lt;b&gt; is" in job_html(refused)
    assert "no memory" in until(jobs.begin("x", "dies", suffix=".html"), "failed").why


def test_jobs_are_bounded_cancelled_and_end_with_the_server():
    with BackgroundJobs((sys.executable, "-c", STEPS)) as jobs:
        begun = [jobs.begin("x", "waits", suffix=".html") for _ in range(MAX_RUNNING)]
        with refused("too-many-jobs", InputError):
            jobs.begin("x", "waits", suffix=".html")
        jobs.cancel(begun[0].number)
        assert until(begun[0], "cancelled").process.wait(10) != 0
        last = jobs.begin("x", "waits", suffix=".html")
    assert all(job.process.poll() is not None for job in (*begun, last))
    assert not last.out.parent.exists()


@pytest.mark.parametrize(
    ("scores", "named", "loud"),
    [
        ({"learnt_from_this_run": True}, "", True),
        ({"same_session": "monday"}, "monday", True),
        ({}, "tuesday", False),
    ],
)
def test_a_score_says_whether_it_is_of_another_day(jobs, scores, named, loud):
    score = {"mae": 0.008, "unit": "N", "n": 68, "coverage_90": 1.0}
    score |= {"coverage_90_low": 0.8, "coverage_90_high": 1.0}
    found = {"targets": {"force_N": score}, "learnt_from_this_run": False, "same_session": ""}
    found |= {"session": ["tuesday"]} | scores
    job = until(jobs.begin("scored", "does", Path("x"), suffix=".json"), "done")
    job.found = found
    told = job_html(job)
    assert named in told
    assert ("trouble" in told) == loud

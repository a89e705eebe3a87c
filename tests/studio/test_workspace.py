"""The workspace shows what lies in it, says how it stands, and nothing leads out of it."""

import asyncio
import json
import os

import cv2
import numpy as np
import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed")

import httpx
from fastapi import FastAPI
from tests.refusals import refused
from tests.studio.small_run import write_small_run

from palpate.core import InputError, PalpateError
from palpate.studio.library.background_jobs import BackgroundJobs
from palpate.studio.library.workspace import (
    MAX_PX,
    SHEET_POLICY,
    OutsideError,
    SourceTreeError,
    Workspace,
    add_library_routes,
)


@pytest.fixture
def workspace(tmp_path):
    write_small_run(tmp_path / "at" / "runs" / "one")
    return Workspace(tmp_path / "at")


class Asked:
    """Asks an application without a server."""

    def __init__(self, app):
        self._transport = httpx.ASGITransport(app)

    def get(self, address, **options):
        async def ask():
            async with httpx.AsyncClient(transport=self._transport, base_url="http://localhost") as client:
                return await client.get(address, **options)

        return asyncio.run(ask())


@pytest.fixture
def client(workspace):
    app = FastAPI()
    with BackgroundJobs() as jobs:
        add_library_routes(app, workspace, jobs)
        yield Asked(app)


def test_a_run_is_listed_with_its_frames_its_length_its_labels_and_its_state(workspace):
    assert workspace.found("run") == ["runs/one"]
    found = workspace.summary("runs/one")
    assert (found.frames, found.state, found.targets) == (30, "whole", ("force_N",))
    assert found.length_s == pytest.approx(2.9)
    assert found.labels == ("force_N", "press", "reference")
    assert found.size_bytes == sum(path.stat().st_size for path in (workspace.folder / "runs/one").iterdir())


def test_a_run_that_is_cut_is_said_to_be_so_and_a_damaged_one_why(workspace):
    cut = write_small_run(workspace.folder / "cut")
    frames = cut / "0000-frames.mcap"
    os.truncate(frames, frames.stat().st_size - 40)
    os.utime(frames, (0, 0))
    for one in cut.iterdir():
        os.utime(one, (0, 0))
    assert workspace.summary("cut").state == "not closed"
    os.utime(frames)  # as it grows
    assert workspace.summary("cut").state == "being written"
    (cut / "manifest.json").write_text("{")
    for one in ("0000-frames.mcap", "0000-signals.mcap"):
        (cut / one).write_bytes(b"")
    broken = workspace.summary("cut")
    assert broken.state == "damaged"
    assert "manifest" in broken.why


@pytest.mark.parametrize(
    "name",
    ["..", "../secret", "/etc", "runs/../../secret", "runs/one\0", "link", "link/run", "", ".", "runs\\one",
     "x" * 2000, "runs/one\n"],
)  # fmt: skip
def test_nothing_leads_out_of_the_workspace(workspace, tmp_path, name):
    write_small_run(tmp_path / "secret" / "run")
    (workspace.folder / "link").symlink_to(tmp_path / "secret")
    with refused("outside-workspace", InputError):
        workspace.resolve(name)
    assert workspace.found("run") == ["runs/one"]  # nor is what a link leads to listed


def test_a_link_within_the_workspace_is_followed_when_it_is_named(workspace):
    (workspace.folder / "again").symlink_to(workspace.folder / "runs" / "one")
    assert len(workspace.run("again")) == 30


@pytest.mark.parametrize("depth", [1, 2])
def test_a_run_whose_files_are_links_out_of_the_workspace_is_not_opened(workspace, tmp_path, depth):
    secret = tmp_path / "secret.bin"
    secret.write_bytes(b"x")
    inside = workspace.folder / "runs" / "one" / "/".join((depth - 1) * ["deeper"])
    inside.mkdir(exist_ok=True)
    (inside / "within").symlink_to(workspace.folder / "runs")
    assert workspace.resolve("runs/one").is_dir()
    (inside / "more").symlink_to(secret)
    with pytest.raises(OutsideError) as refused:
        workspace.run("runs/one")
    assert refused.value.code == "outside-workspace"


@pytest.mark.parametrize("below", ["", "my-sensor", "src/palpate"])
def test_a_source_tree_of_this_package_is_no_workspace(tmp_path, below):
    tree = tmp_path / "checkout"
    (tree / below).mkdir(parents=True)
    project = tree / "pyproject.toml"
    project.write_text('[project]\nname = "palpate-data"\n')
    Workspace(tree / below)
    project.write_text('[build-system]\n[project]\nname = "palpate"\n')
    with pytest.raises(SourceTreeError) as refused:
        Workspace(tree / below)
    assert refused.value.code == "source-tree"
    Workspace(tmp_path / "elsewhere")


def test_a_frame_is_served_as_it_was_recorded_by_its_number(client):
    answer = client.get("/run/frame", params={"run": "runs/one", "index": 7, "px": 960})
    assert (answer.status_code, answer.headers["content-type"]) == (200, "image/jpeg")
    image = cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_COLOR)
    assert image.shape == (24, 32, 3)  # and not larger
    assert abs(int(image.mean()) - 35) <= 1
    small = client.get("/run/frame", params={"run": "runs/one", "index": 7, "px": 16}).content
    assert cv2.imdecode(np.frombuffer(small, np.uint8), cv2.IMREAD_COLOR).shape == (12, 16, 3)
    told = client.get("/run/labels", params={"run": "runs/one", "index": 7}).json()
    assert told == {
        "time_s": pytest.approx(0.7),
        "labels": {"force_N": 7.0, "press": "p0", "reference": False},
    }


@pytest.mark.parametrize(
    ("asked", "code"),
    [({"index": 30}, 404), ({"index": -1}, 422), ({"index": "x"}, 422), ({"px": MAX_PX + 1}, 422),
     ({"px": 1}, 422), ({"index": 10**12}, 422)],
)  # fmt: skip
def test_frames_and_widths_have_bounds(client, asked, code):
    assert (
        client.get("/run/frame", params={"run": "runs/one", "index": 0, "px": 64} | asked).status_code == code
    )


@pytest.mark.parametrize(
    "path",
    [
        "run=../secret",
        "run=%2e%2e%2fsecret",
        "run=%2Fetc",
        "run=runs%2Fone%00",
        "run=..%5Csecret",
        "run=none",
    ],
)
def test_encoded_paths_lead_nowhere_either(client, path):
    for what in ("frame", "labels"):
        answer = client.get(f"/run/{what}?{path}&index=0&px=64")
        assert answer.status_code in (404, 422)
        assert "image" not in answer.headers["content-type"]


def test_a_page_that_a_job_wrote_runs_no_script(workspace, client):
    assert client.get("/sheet/1").status_code == 404
    assert "sandbox" in SHEET_POLICY
    assert "script" not in SHEET_POLICY


def test_a_calibration_that_is_none_says_so(workspace):
    folder = workspace.folder / "cal"
    folder.mkdir()
    (folder / "card.json").write_text(json.dumps({"format": "palpate-calibration/1"}))
    assert workspace.found("calibration") == ["cal"]
    with pytest.raises(PalpateError):
        workspace.card("cal")

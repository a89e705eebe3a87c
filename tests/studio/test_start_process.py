"""A session's process that is told to end closes what it records, and every label is there."""

import json
import signal
import subprocess
import sys

import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed")

from palpate.recordings import Run

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]


def test_no_frame_lacks_its_labels_after_a_process_was_told_to_end(tmp_path):
    words = [str(tmp_path / "mine"), "--camera", "virtual:palm", "--scale", "virtual", "--presses", "30"]
    process = subprocess.Popen(
        [sys.executable, "-m", "palpate.studio.live.start_process", *words],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    with process:
        for line in process.stdout:
            told = json.loads(line)
            assert "error" not in told, told
            if told.get("collect", {}).get("presses", 0) >= 3:
                process.send_signal(signal.SIGTERM)
                break
        process.communicate(timeout=120)
    run = Run.open(tmp_path / "mine" / "presses")
    assert run.labels["press"].nunique() >= 3
    assert run.labels["force_N"].notna().all()
    assert not [one for segment in run.segments for one in segment.damage]

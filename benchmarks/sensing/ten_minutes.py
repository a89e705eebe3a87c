"""The studio over minutes: a palm at 30 Hz, a NUSense at 12 Hz, two recordings at their own rate, a browser.

Run ``OMP_NUM_THREADS=1 python benchmarks/sensing/ten_minutes.py [--minutes 10] [--rendered palm]`` on a
machine that does nothing else. Each sensor is read by a process of its own, as the studio begins them: the
palm by a calibration of force and depth that is made here of what a virtual hand presses, the NUSense by
its marks, the recordings without a calibration, over and over. The studio is served by a process of its
own, and a headless Chromium shows all four on /live, where there is one.

Counts, rates and latencies are of the minutes after the warm-up, in which the palm's pictures are drawn for
the first time; percentiles are of the last 1000 frames of a sensor. Latency counts from a frame's arrival
to its readings. "alone" is what the reader takes of the processor for a frame in memory, nothing else being
done: the baseline. "process" is what the whole process took for a frame, drawing it included. No time is
judged.
"""

from __future__ import annotations

import argparse
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote, urlsplit

import numpy as np
from live_loop import FRAMES, SEED, alone, calibrated, pressed

from palpate.core import Frame, ManualClock
from palpate.devices.rpc import Address, workspace_folder
from palpate.rig.virtual.virtual_hand import VirtualHand
from palpate.sensing.live_client import LiveClient, launch_live
from palpate.sensing.live_service import LiveOptions
from palpate.sensing.streaming.live_readers import mean_image, open_reader
from palpate.sensing.streaming.touch_readers import open_shear_reader

ROOT = Path(__file__).resolve().parents[2]
RATES_HZ = {"palm": 30.0, "nusense": 12.0}
RECORDED = 240  # frames of each recording
SKIN = "nusense"
UNTOUCHED = 10  # of the first second, in which the hand waits
FEW = 60  # frames that the reader of marks is timed on, and zeroed by
TICKS_HZ = os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True)
class Moment:
    """Counts of one sensor's process at one time: as it tells them, memory [MB], processor time [s]."""

    status: dict[str, Any]
    memory_mb: float
    processor_s: float


def marked_frames(count: int) -> list[Frame]:
    """Frames of a virtual hand on a NUSense, at its camera's rate."""
    hand = VirtualHand(SKIN, seed=SEED, clock=ManualClock())
    frames = [hand.camera.grab()[1] for _ in range(count)]
    hand.close()
    return frames


def recorded(frames: list[Frame], rate_hz: float, path: Path) -> Path:
    """A run of frames with their own times."""
    from palpate.recordings import Manifest, RunWriter

    clock = ManualClock()
    with RunWriter.create(path, Manifest.new(sensor=path.name), clock=clock, overflow="wait") as writer:
        for frame in frames:
            writer.frame(frame.image)
            clock.sleep(1 / rate_hz)
    return path


def marks_alone(frames: list[Frame]) -> float:
    """Milliseconds of the processor that the reader of marks takes for a frame, the median.

    It is zeroed as live, by an average of untouched frames.
    """
    reader = open_shear_reader(SKIN, reference=mean_image([one.image for one in frames[:UNTOUCHED]]))
    taken = []
    for frame in frames[UNTOUCHED:]:
        begun = time.process_time()
        reader.read(frame)
        taken.append(1e3 * (time.process_time() - begun))
    return float(np.median(taken))


def moment(client: LiveClient, pid: int) -> Moment:
    """What a sensor's process tells now, and what it has taken."""
    status = client.status
    assert status is not None, "a sensor's process has ended"
    resident = int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return Moment(status, resident, (int(fields[11]) + int(fields[12])) / TICKS_HZ)


@contextmanager
def studio(workspace: Path) -> Iterator[str]:
    """The studio, served by a process of its own; the address that it prints, with its token."""
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = probe.getsockname()[1]
    words = ["palpate", "studio", "--workspace", str(workspace), "--port", str(port)]
    code = f"import sys; sys.argv = {words!r}; from palpate.cli import main; main()"
    process = subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    assert process.stdout is not None
    address = process.stdout.readline().split()[0]
    try:
        end_s = time.monotonic() + 120.0
        while time.monotonic() < end_s:
            try:
                socket.create_connection(("127.0.0.1", port), 5).close()
                break
            except OSError:
                time.sleep(0.1)
        yield address
    finally:
        process.terminate()
        process.communicate()


@contextmanager
def browsed(url: str, folder: Path) -> Iterator[Any]:
    """A headless browser at an address; None where there is no Chromium, or no client to drive it."""
    sys.path.insert(0, str(ROOT))
    try:
        from tests.studio import devtools
    except ImportError:
        yield None
        return
    if devtools.chromium() is None or not shutil.which(devtools.chromium() or ""):
        yield None
        return
    browser = devtools.Browser(folder)
    try:
        yield browser.open(url)
    finally:
        browser.close()


@contextmanager
def live(name: str, options: LiveOptions, folder: Path) -> Iterator[tuple[LiveClient, Address]]:
    """A live sensor's process, with its address file in a folder, and a client of it."""
    _, address = launch_live(name, options, folder=folder)
    with LiveClient(name, folder) as client:
        try:
            yield client, address
        finally:
            client.shutdown()


def line(name: str, before: Moment, after: Moment, alone_ms: float | None) -> str:
    """One sensor's row."""
    frames, dropped, lost = (after.status[k] - before.status[k] for k in ("frames", "dropped", "lost"))
    share = 100 * dropped / max(frames + dropped, 1)
    late = " / ".join(
        "–" if after.status[k] is None else f"{after.status[k]:.1f}" for k in ("p50_ms", "p95_ms", "p99_ms")
    )
    process_ms = 1e3 * (after.processor_s - before.processor_s) / max(frames, 1)
    rate = after.status["rate_hz"] or 0.0
    reader = "     –" if alone_ms is None else f"{alone_ms:6.2f}"
    return (
        f"{name:26s} {frames:7d} {dropped:6d} ({share:5.2f} %) {lost:5d} {rate:6.2f}  {late:22s} {reader} "
        f"{process_ms:8.2f}  {before.memory_mb:7.1f} {after.memory_mb:7.1f}"
    )


def measured(minutes: float, warm_up_s: float, folder: Path, rendered: str = "both") -> None:
    """Make what is read, begin everything, wait, and print a row a sensor."""
    runtime, workspace = folder / "run", folder / "ws"
    runtime.mkdir()
    workspace.mkdir()
    os.environ["XDG_RUNTIME_DIR"] = str(runtime)
    frames, truths = pressed(FRAMES)
    calibration = calibrated(frames, truths, workspace)
    palm_ms = float(np.median(alone(open_reader(calibration, threads=1), frames)[1]))
    marked = marked_frames(max(RECORDED, FEW))
    nusense_ms = marks_alone(marked[:FEW])
    recorded(frames[:RECORDED], RATES_HZ["palm"], workspace / "recorded-palm")
    recorded(marked[:RECORDED], RATES_HZ["nusense"], workspace / "recorded-nusense")
    played = {"paced": True, "repeat": True}
    sensors = {
        "live virtual:palm": (LiveOptions("virtual:palm", str(calibration), seed=SEED), palm_ms),
        "live virtual:nusense": (LiveOptions("virtual:nusense", shear=SKIN, seed=SEED), nusense_ms),
        "live recorded-palm": (LiveOptions(str(workspace / "recorded-palm"), **played), None),
        "live recorded-nusense": (LiveOptions(str(workspace / "recorded-nusense"), **played), None),
    }
    sensors = {
        name: one for name, one in sensors.items()
        if rendered == "both" or not name.startswith("live virtual:") or name.endswith(rendered)
    }  # fmt: skip
    with ExitStack() as stack:
        address = urlsplit(stack.enter_context(studio(workspace)))
        addresses = workspace_folder(workspace)
        clients = {
            name: stack.enter_context(live(name, options, addresses))
            for name, (options, _) in sensors.items()
        }
        for client, _ in clients.values():
            client.wait_for(lambda status: status["state"] == "live", 120.0)
        shown_sensors = "&".join(f"sensor={quote(name)}" for name in sensors)
        url = f"http://{address.netloc}/live?{shown_sensors}&{address.query}"
        tab = stack.enter_context(browsed(url, folder / "profile"))
        time.sleep(warm_up_s)
        before = {name: moment(client, address.pid) for name, (client, address) in clients.items()}
        time.sleep(60.0 * minutes)
        after = {name: moment(client, address.pid) for name, (client, address) in clients.items()}
        shown = 0 if tab is None else tab.run("document.querySelectorAll('.card.live img').length")
        print(
            f"{minutes:g} minutes after {warm_up_s:g} s; a browser shows {shown} pictures; load "
            f"{os.getloadavg()[0]:.1f} on {os.cpu_count()} cores; BLAS threads "
            f"{os.environ.get('OMP_NUM_THREADS', 'as many as there are cores')}"
        )
        print(
            f"{'sensor':26s} {'frames':>7s} {'dropped':>16s} {'lost':>5s} {'Hz':>6s}  "
            f"{'p50 / p95 / p99 [ms]':22s} {'alone':>6s} {'process':>8s}  {'MB then':>7s} {'MB now':>7s}"
        )
        for name, (_, alone_ms) in sensors.items():
            print(line(name.removeprefix("live "), before[name], after[name], alone_ms))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--warm-up", type=float, default=60.0, help="[s]")
    parser.add_argument(
        "--rendered", choices=["palm", "nusense", "both"], default="both", help="virtual sensors drawn live"
    )
    words = parser.parse_args()
    import cv2

    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory() as folder:
        measured(words.minutes, words.warm_up, Path(folder), words.rendered)


if __name__ == "__main__":
    main()

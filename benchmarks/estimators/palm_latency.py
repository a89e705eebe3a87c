"""One frame through the palm's networks: torch eager and onnxruntime, small and published, and to a Reading.

Run ``python benchmarks/estimators/palm_latency.py [--threads 2] [--side 128] [--calibration FOLDER]``. The
networks have random weights, since their speed does not depend on them, and take one image of two views; each
is timed in turn with the others, round after round, so that all see the machine's other work. Then a
calibration reads frames: crop and scale, the guard, the network, the intervals. Unless one is given, it is
made here of rendered presses (about a minute); its frames are as large as the network's input, and a second
line adds what shrinking a full 1920 x 1080 px frame takes. Frames are in memory. No time is judged, only
printed.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

ROUNDS, FRAMES, WARM = 10, 30, 3
PRESSES, DEPTHS = 70, 13  # about as many frames as a calibration of 37 places in 2 cycles
ASKED_RATIO, ASKED_MS = 1 / 5, 8.0


def taken_in_turn(calls: dict[str, Callable[[], object]]) -> dict[str, np.ndarray]:
    """Milliseconds of each call ``[round frame]``, in rounds."""
    taken = {name: np.empty((ROUNDS, FRAMES)) for name in calls}
    for i in range(ROUNDS):
        for name, call in calls.items():
            for j in range(-WARM, FRAMES):
                started = time.perf_counter()
                call()
                if j >= 0:
                    taken[name][i, j] = 1e3 * (time.perf_counter() - started)
    return taken


def row(name: str, ms: np.ndarray) -> None:
    print(f"  {name:44s} median {np.median(ms):7.2f} ms, p95 {np.percentile(ms, 95):7.2f} ms")


def ratio(name: str, above: np.ndarray, below: np.ndarray, asked: str = "") -> None:
    """Ratio of medians, round by round."""
    each = np.median(above, axis=1) / np.median(below, axis=1)
    low, middle, high = np.quantile(each, [0.25, 0.5, 0.75])
    print(f"  {name:44s} {middle:.3g}, middle half {low:.3g} to {high:.3g}{asked}")


def networks(side: int) -> dict[str, tuple[Any, tuple[int, int, int]]]:
    """The two, untrained, and the shape of their inputs."""
    from palpate.estimators.networks.model_interface import Scaler
    from palpate.sensors.palm.networks.palm_compact import CompactPalmNetwork
    from palpate.sensors.palm.networks.palm_report_networks import TwoStageNetwork
    from palpate.sensors.palm.networks.palm_training import Scales

    def scales(targets: int) -> Scales:
        plain = Scaler(np.zeros(targets), np.ones(targets))
        return Scales(side, (0.0, 0.0), (20.0, 20.0), plain, tuple(range(targets)))

    return {
        "palm-compact": (CompactPalmNetwork(3, side, scales(4)).eval(), (3, side, 2 * side)),
        "palm-two-stage": (TwoStageNetwork(1, scales(7)).eval(), (1, side, 2 * side)),
    }


def session(model: bytes, threads: int) -> Any:
    """Session as `Estimator` opens one."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    return onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])


def compared(side: int, threads: int) -> None:
    """Both networks in both runtimes."""
    import torch

    rng = np.random.default_rng(0)
    calls: dict[str, Callable[[], object]] = {}
    for name, (network, shape) in networks(side).items():
        image = rng.normal(0, 20, (1, *shape)).astype(np.float32)
        held, exported = torch.from_numpy(image), session(network.to_onnx(shape).SerializeToString(), threads)

        def eager(network: Any = network, held: Any = held) -> Any:
            with torch.no_grad():
                return network.values(held)

        def run(exported: Any = exported, image: Any = image) -> Any:
            return exported.run(["value"], {"image": image})[0]

        assert np.allclose(run(), eager().numpy(), atol=1e-3), name
        calls |= {f"{name}, torch eager": eager, f"{name}, onnxruntime": run}
    ms = taken_in_turn(calls)
    print(f"the networks alone, fp32, {side} x {side} px a view, one image:")
    for name, times in ms.items():
        row(name, times)
    small, published = ms["palm-compact, onnxruntime"], ms["palm-two-stage, onnxruntime"]
    eager_ms = ms["palm-two-stage, torch eager"]
    ratio("compact / two-stage, both onnxruntime", small, published, f" (asked: {ASKED_RATIO:g} at most)")
    ratio("compact, onnxruntime / two-stage, torch eager", small, eager_ms)
    ratio("two-stage, onnxruntime / torch eager", published, eager_ms)


def calibrated(folder: Path, side: int) -> Path:
    """A palm-compact of rendered presses, trained for one epoch: as fast as one that knows its task."""
    from palpate import CalibrationPlan, Manifest, Run, RunWriter, calibrate
    from palpate.calibration import ReferenceRule
    from palpate.sensors import palm
    from palpate.sensors.palm.random_presses import TARGETS, draw_presses

    spec = palm.cropped(palm.preset("palm"), side, "palm-rendered")
    drawn = draw_presses(spec, PRESSES, DEPTHS, np.random.default_rng(0))
    kinds: dict[str, Any] = dict.fromkeys(TARGETS, "number") | {"press": "text", "reference": "flag"}
    with RunWriter.create(
        folder / "run", Manifest.new(sensor="rendered palm", labels=kinds), overflow="wait"
    ) as writer:
        for press, hanging in enumerate(drawn.hanging):
            about: dict[str, Any] = {"press": str(press), "reference": True}
            writer.frame(hanging, labels=about | dict.fromkeys(TARGETS, 0.0))
            for i in np.flatnonzero(drawn.press == press):
                held = dict(zip(TARGETS, map(float, drawn.values[i]), strict=True))
                writer.frame(drawn.images[i], labels=held | about | {"reference": False})
    plan = CalibrationPlan(
        TARGETS,
        model="palm-compact",
        split="group:press",
        scored_folds=1,
        size_px=(side, 2 * side),
        channels=3,
        crop_px=(0, 0, side, side),
        beside_px=(side, 0, side, side),
        delta=True,
        reference=ReferenceRule("reference", "true", ("press",)),
        options={"rendered": 0, "epochs": 1},
    )
    return calibrate(Run.open(folder / "run"), plan, folder / "cal")


def read(calibration: Path, frames: list[Any], threads: int) -> None:
    """Frames to Readings."""
    from palpate import Estimator
    from palpate.recordings.preparation import Preparation
    from palpate.sensors import palm

    estimator = Estimator.open(calibration, threads=threads)
    zero = estimator.zero(frames[0].image)
    whole = palm.preset("palm")
    full = np.random.default_rng(0).integers(0, 255, (*whole.frame_px[::-1], 3), np.uint8)
    made = estimator.card.input
    shrink = Preparation(whole.fringes.box_px, made.size_px, made.channels, whole.mirror.box_px)
    at = iter(range(10**9))

    def one() -> object:
        return estimator.read(frames[next(at) % len(frames)], zero)

    def one_of_the_camera() -> object:
        shrink.apply(full)
        return one()

    height, width = made.frame_px
    inputs = np.zeros((1, made.channels, *made.size_px), np.float32)
    ms = taken_in_turn({"read": one, "full": one_of_the_camera, "network": lambda: estimator.values(inputs)})
    print(f"{estimator.card.model_name}, {made.size_px[0]} x {made.size_px[1]} px, frame to Readings:")
    row(f"frame of {width} x {height} px", ms["read"])
    row(f"and shrinking {whole.frame_px[0]} x {whole.frame_px[1]} px besides", ms["full"])
    row("its network alone", ms["network"])
    ratio("frame to Readings / its network alone", ms["read"], ms["network"])
    over = np.percentile(ms["read"], 95) / ASKED_MS
    print(f"  {'p95 of frame to Readings / what is asked':44s} {over:.2g} (asked: {ASKED_MS:g} ms at most)")


def main() -> None:
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    asked.add_argument("--threads", type=int, default=2)
    asked.add_argument("--side", type=int, default=128, help="of each view [px], a multiple of 16")
    asked.add_argument("--calibration", type=Path, help="one to read with, instead of making one")
    given = asked.parse_args()
    try:
        import torch
    except ImportError:
        print("torch is not installed, so there is no baseline: pip install 'palpate[train]'")
        return
    from palpate import Frame, Run
    from palpate.estimators import read_card

    torch.set_num_threads(given.threads)
    print(f"{given.threads} threads, load {os.getloadavg()[0]:.1f}, {ROUNDS} rounds of {FRAMES} frames")
    compared(given.side, given.threads)
    if given.calibration is not None:
        size = read_card(given.calibration).input.frame_px
        rng = np.random.default_rng(0)
        frames = [Frame(rng.integers(0, 255, (*size, 3), np.uint8), float(i)) for i in range(8)]
        read(given.calibration, frames, given.threads)
        return
    with tempfile.TemporaryDirectory() as folder:
        made = calibrated(Path(folder), given.side)
        frames = list(Run.open(Path(folder, "run")).frames())[:100]
        read(made, frames, given.threads)


if __name__ == "__main__":
    main()

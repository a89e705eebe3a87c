"""The real drivers, each against its fake over a real socket or terminal, keep what the protocols promise."""

import random
import sys

import pytest
from tests.fakes.grbl_firmware import GrblFirmware
from tests.fakes.grbl_parameters import GrblFaults, GrblParameters
from tests.fakes.netft_box import FakeNetFT
from tests.fakes.video_capture import FakeVideoCapture
from tests.rig.serial_terminal import FakeTerminal

from palpate.core import MonotonicClock
from palpate.devices.check.camera_check import check_camera
from palpate.devices.check.force_check import check_force_sensor
from palpate.devices.check.interface_check import CheckResult
from palpate.devices.check.stage_check import check_stage
from palpate.rig.real.grbl.grbl_stage import GrblStage
from palpate.rig.real.grbl.grbl_supervisor import GrblSpec
from palpate.rig.real.netft.netft_sensor import NetFT, NetFTSettings
from palpate.rig.real.uvc_camera import UvcCamera, UvcSettings

# What a loaded machine may break although the driver keeps it.
TIMING = ("latest-age", "sample-gap", "frame-interval", "call-time", "sample-rate", "frame-rate")


def broken(findings: list[CheckResult], timed: bool = False) -> list[CheckResult]:
    return [one for one in findings if not one.ok and (timed or one.code not in TIMING)]


timed_when_slow = pytest.mark.parametrize("timed", [False, pytest.param(True, marks=pytest.mark.slow)])


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="a pseudo-terminal needs POSIX")
@pytest.mark.parametrize("firmware", ["1.1h", "grblHAL"])
def test_the_grbl_driver_keeps_every_law(firmware: str) -> None:
    clock = MonotonicClock()
    model = GrblParameters(firmware=firmware, homed=True, latency_s=0.01, print_s=0.006)
    with FakeTerminal(GrblFirmware(model, GrblFaults(), clock.now_ns() / 1e9), clock) as terminal:
        spec = GrblSpec(terminal.path, boot_s=0.02, latency_s=0.05)
        with GrblStage.open(spec, clock) as stage:
            stage.reference()
            x, y, z = stage.position_m()
            half = 5e-3
            box = ((x - half, y - half, z - half), (x + half, y + half, z + half))
            found = check_stage(stage, clock=clock, region_m=box, speed_m_s=4e-3)
    assert broken(found) == []


@timed_when_slow
def test_the_net_ft_driver_keeps_every_law(timed: bool) -> None:
    draw = random.Random(0)
    with FakeNetFT(force=lambda t: (draw.gauss(0, 0.01), 0.2, draw.gauss(-1, 0.01))) as box:
        settings = NetFTSettings(rdt_port=box.rdt_port, http_port=box.http_port, silence_s=5.0)
        with NetFT(box.host, settings) as sensor:
            found = check_force_sensor(sensor, clock=MonotonicClock(), seconds=1.0)
    assert broken(found, timed) == []


@timed_when_slow
def test_the_camera_driver_keeps_every_law(timed: bool) -> None:
    settings = UvcSettings(size_px=(64, 48), rate_hz=50.0, exposure_s=5e-3)
    source = FakeVideoCapture(rate_hz=50.0)
    with UvcCamera("/dev/video7", settings, opener=lambda where: source) as camera:
        found = check_camera(camera, clock=MonotonicClock())
    assert broken(found, timed) == []

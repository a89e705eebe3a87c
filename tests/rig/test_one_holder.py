"""One process at a time has a device, by whatever name: a second one is told the holder."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from tests.fakes.grbl_firmware import GrblFirmware
from tests.fakes.grbl_parameters import GrblFaults, GrblParameters
from tests.fakes.marlin_firmware import MarlinFaults, MarlinFirmware, MarlinParameters
from tests.fakes.printing_scale import PrintingScale, ScaleFaults
from tests.refusals import refused
from tests.rig.lab_files import EchoModem, environment, lab_file, palpate, served
from tests.rig.serial_terminal import SerialDevice
from tests.slow_params import mostly_slow

from palpate.core import NS_PER_S, DeviceError, MonotonicClock
from palpate.rig.commissioning import bench
from palpate.rig.real import device_hold, serial_port
from palpate.rig.real.device_hold import box_named, camera_named, hold_device, port_named
from palpate.rig.real.netft.netft_sensor import NetFT, NetFTSettings
from palpate.rig.real.serial_port import SerialPort, describe_heard, open_port
from palpate.rig.rig_file import open_rig

pytest.importorskip("serial", reason="a stage's port needs pyserial")
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="a pseudo-terminal needs POSIX")
HOLD = "import sys\nfrom palpate.rig.real.device_hold import hold_device\nheld = hold_device(sys.argv[1])\n"


def test_a_device_that_is_held_is_refused_with_the_holders_pid_and_free_once_that_is_killed() -> None:
    device = f"port of {os.getpid()}"
    script = HOLD + "print('held', flush=True)\nsys.stdin.read()\n"
    with subprocess.Popen(
        [sys.executable, "-c", script, device],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment(),
    ) as other:  # fmt: skip
        assert other.stdout
        assert other.stdout.readline() == "held\n"
        with refused("device-held", DeviceError, match=str(device)):
            hold_device(device)
        hold_device(device + " and another one").release()
        other.kill()
        other.wait()
        hold_device(device).release()


def test_names_of_one_device_are_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    link = tmp_path / "by-id"
    link.symlink_to("/dev/null")
    assert port_named(str(link)) == port_named("/dev/null") == "port /dev/null"
    assert box_named("localhost", 1) == box_named("127.0.0.1", 1) != box_named("127.0.0.1", 2)
    monkeypatch.setattr(device_hold.sys, "platform", "linux")
    assert camera_named(0) == camera_named("/dev/video0") != camera_named(1)


def test_a_port_by_its_path_a_link_and_its_adapters_serial_number_is_one_port(tmp_path, monkeypatch):
    class Listed:
        serial_number = "A50285BI"

        def __init__(self, device: str) -> None:
            self.device = device

    with served(EchoModem()) as path:
        monkeypatch.setattr(serial_port, "_ports", lambda: [Listed(path)])
        link = tmp_path / "by-id"
        link.symlink_to(path)
        first = open_port("A50285BI", 115200)
        for name in (path, str(link), "A50285BI"):
            with refused("device-held", DeviceError):
                open_port(name, 115200)
        first.close()
        open_port(str(link), 115200).close()


def test_a_box_serves_one_client_and_a_second_one_leaves_its_stream_alone(tmp_path: Path) -> None:
    with lab_file(tmp_path) as lab:
        settings = NetFTSettings(rdt_port=lab.box.rdt_port, http_port=lab.box.http_port, silence_s=5.0)
        with NetFT("127.0.0.1", settings) as first:
            with refused("device-held", DeviceError, match=r"127\.0\.0\.1"):
                NetFT("localhost", settings)
            starts = [one for one in lab.box.requests if one.command == 2]
            assert len({one.source for one in starts}) == 1
            first.latest()
        NetFT("localhost", settings).close()


@pytest.mark.parametrize(
    "words",
    [
        pytest.param(("record", "--plan", "layer", "--out", "{run}", "--rig"), marks=pytest.mark.slow),
        pytest.param(("rig", "check"), marks=pytest.mark.slow),
        ("rig", "jog", "--axis", "x", "--mm", "1"),
    ],
)  # fmt: skip
def test_a_second_programme_on_a_rig_in_use_is_refused_with_the_pid_and_moves_nothing(tmp_path, words):
    with lab_file(tmp_path) as lab:
        file = lab.write()
        with closing(open_rig(file)) as rig:
            done = palpate(*(word.format(run=tmp_path / "run") for word in words), file)
            holder = rig.supervisor.pid
        assert done.returncode == 2, done
        assert str(holder) in done.stderr
        assert not (tmp_path / "run").exists()
        assert not lab.jogged


def test_a_rig_file_that_names_one_port_twice_is_refused(tmp_path: Path) -> None:
    with lab_file(tmp_path) as lab:
        file = lab.write(label_force={"kind": "serial-scale", "port": lab.terminal.path, "unit": "g"})
        with refused("no-samples", DeviceError):
            open_rig(file)
        assert not lab.jogged


HOLDER = """
import signal, sys, time
from palpate.rig.real.device_hold import hold_device, port_named
held = hold_device(port_named(sys.argv[1]))
if sys.argv[2] == "deaf":
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
print("held", flush=True)
time.sleep(60)
"""


@pytest.mark.parametrize("manner", ["hears", "deaf"])
def test_a_stop_ends_whoever_has_the_port_then_stops_the_stage_or_says_that_it_could_not(
    tmp_path, monkeypatch, manner
):
    monkeypatch.setattr(bench, "LET_GO_S", 1.0 if manner == "deaf" else 20.0)
    with lab_file(tmp_path) as lab, subprocess.Popen(
        [sys.executable, "-c", HOLDER, lab.terminal.path, manner],
        stdout=subprocess.PIPE, text=True, env=environment(),
    ) as other:  # fmt: skip
        try:
            assert other.stdout
            assert other.stdout.readline() == "held\n"
            if manner == "hears":
                assert str(other.pid) in bench.stop_rig(lab.write()).how
                assert other.wait(5) == -signal.SIGTERM
            else:
                with refused("stop-not-confirmed", DeviceError, match=str(other.pid)):
                    bench.stop_rig(lab.write())
                assert other.poll() is None
        finally:
            other.kill()


# Writes to a serial port: late only if the port takes nothing, never by a stall of the host.


@pytest.fixture
def terminal() -> Iterator[tuple[int, SerialPort]]:
    pytest.importorskip("serial", reason="serial ports need pyserial")
    controller, device = os.openpty()
    port = open_port(os.ttyname(device), 115200)
    yield controller, port
    port.close()
    os.close(controller)
    os.close(device)


def test_a_stall_of_the_host_within_a_write_is_no_failure(terminal, monkeypatch: pytest.MonkeyPatch) -> None:
    controller, port = terminal
    write = os.write

    def stalled(handle: int, data: bytes) -> int:
        taken = write(handle, data)
        time.sleep(0.3)
        return taken

    monkeypatch.setattr(serial_port, "WRITE_S", 0.1)
    monkeypatch.setattr(os, "write", stalled)
    port._port.write_timeout = 0.1
    with pytest.raises(Exception, match="Write timeout"):  # the control: pyserial alone
        port._port.write(b"?")
    assert port.write(b"\x85") == 1
    assert os.read(controller, 10) == b"?\x85"


def test_a_port_that_takes_nothing_is_late(terminal, monkeypatch: pytest.MonkeyPatch) -> None:
    _, port = terminal
    monkeypatch.setattr(serial_port, "WRITE_S", 0.1)
    with pytest.raises(TimeoutError):
        port.write(bytes(1_000_000))


# A port that is another device: refused before anything moves, with what it said and who speaks so.

pytest.importorskip("serial", reason="a stage's port needs pyserial")
GRBL = {
    "kind": "grbl", "boot_s": 0.05, "reply_s": 0.4, "steps_per_mm": [250, 250, 250], "direction_mask": 0,
}  # fmt: skip
MARLIN = {
    "kind": "marlin", "boot_s": 0.05, "reply_s": 0.4, "reference": [0, 0, 0],
    "steps_per_mm": [80, 80, 400],
    "least_mm": [-50, -50, -50], "greatest_mm": [50, 50, 50],
}  # fmt: skip
SCALE = {"kind": "serial-scale", "unit": "g"}


def device(what: str) -> SerialDevice:
    now_s = MonotonicClock().now_ns() / NS_PER_S
    match what:
        case "grbl":
            return GrblFirmware(GrblParameters(homed=True), GrblFaults(), now_s)
        case "marlin":
            return MarlinFirmware(MarlinParameters(), MarlinFaults(), now_s)
        case "scale":
            return PrintingScale(rate_hz=20.0, now_s=now_s)
        case "noise":
            return PrintingScale(rate_hz=20.0, faults=ScaleFaults(nonsense=True), now_s=now_s)
        case "silent":
            return PrintingScale(faults=ScaleFaults(mute=True), now_s=now_s)
    return EchoModem()


@pytest.mark.parametrize(
    ("what", "part", "said"),
    mostly_slow(
        [
            ("marlin", GRBL, "Marlin"), ("scale", GRBL, "scale"), ("modem", GRBL, "modem"),
            ("noise", GRBL, "baud"), ("silent", GRBL, "nothing"), ("grbl", MARLIN, "GRBL"),
            ("scale", MARLIN, "scale"), ("modem", MARLIN, "modem"), ("silent", MARLIN, "nothing"),
        ],
        lambda i: i == 0,
    ),
)  # fmt: skip
def test_a_stages_port_that_is_another_device_is_refused_with_what_it_said(tmp_path, what, part, said):
    with lab_file(tmp_path) as lab, served(device(what)) as port:
        lab.fields["stage"] = {**part, "port": port}
        with refused(f"not-{part['kind']}", DeviceError, match=said) as told:
            open_rig(lab.write(), supervised=False)
        assert port in str(told.value)
        lab.fields["stage"] = {**GRBL, "port": lab.terminal.path, "reference": "counts"}
        open_rig(
            lab.write(), supervised=False, position="reference"
        ).close()  # the control: the right one is taken, also after what failed


@pytest.mark.parametrize(
    ("what", "ask", "said"),
    [
        ("grbl", "SI", "GRBL"),
        ("marlin", "SI", "Marlin"),
        pytest.param("modem", "SI", "modem", marks=pytest.mark.slow),
        pytest.param("grbl", "", "said", marks=pytest.mark.slow),
        ("noise", "", "baud"),
    ],
)
def test_a_scales_port_that_is_another_device_is_refused_with_what_it_said(tmp_path, what, ask, said):
    with lab_file(tmp_path) as lab, served(device(what)) as port:
        file = lab.write(label_force={**SCALE, "port": port, "ask": ask})
        with refused("no-samples", DeviceError, match=said) as told:
            open_rig(file, supervised=False)
        assert port in str(told.value)
        assert not lab.jogged


@pytest.mark.parametrize(
    ("heard", "sent", "said"),
    [
        (b"Grbl 1.1h ['$' for help]\r\n", b"", "GRBL"),
        (b"<Idle|MPos:0,0,0|FS:0,0>\r\n", b"?", "GRBL"),
        (b"start\necho:Marlin 2.1\n", b"", "Marlin"),
        (b"4.20 g\r\n 14.20 g\r\n", b"", "scale"),
        (b"ST,+00014.20  g\r\nST,+00014.20  g\r\n", b"", "scale"),
        (b"???", b"????", "modem"),
        (b"\xff\xfe\x01", b"", "baud"),
    ],
)
def test_who_speaks_is_told_by_its_lines(heard: bytes, sent: bytes, said: str) -> None:
    assert said in describe_heard(heard, sent)


def test_lines_of_nobody_known_are_shown_and_nobody_is_named() -> None:
    assert describe_heard(b"login: \r\n").endswith("'login:'")

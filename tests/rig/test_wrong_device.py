"""A port that is another device: refused before anything moves, with what it said and who speaks so."""

import sys

import pytest
from tests.fakes.grbl_firmware import GrblFirmware
from tests.fakes.grbl_parameters import GrblFaults, GrblParameters
from tests.fakes.marlin_firmware import MarlinFaults, MarlinFirmware, MarlinParameters
from tests.fakes.printing_scale import PrintingScale, ScaleFaults
from tests.refusals import refused
from tests.rig.lab_files import EchoModem, lab_file, served
from tests.rig.serial_terminal import SerialDevice
from tests.slow_params import mostly_slow

from palpate.core import NS_PER_S, DeviceError, MonotonicClock
from palpate.rig.real.heard_lines import describe_heard
from palpate.rig.rig_file import open_rig

pytest.importorskip("serial", reason="a stage's port needs pyserial")
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="a pseudo-terminal needs POSIX")
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

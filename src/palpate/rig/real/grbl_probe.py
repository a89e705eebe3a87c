"""What a probing move told."""

from __future__ import annotations

from collections.abc import Iterable

from palpate.core.errors import DeviceError
from palpate.rig.real.grbl_journey import Millimetres
from palpate.rig.real.grbl_lines import Alarm, Line, Probe
from palpate.rig.real.grbl_names import alarm_name


def probed(pushed: Iterable[Line]) -> Millimetres | None:
    """Where the probe triggered, in machine coordinates [mm]; None if it did not.

    Judged by the flag of the report and by there being no alarm. Not by the `ok`, which comes either way,
    nor by the place: on a miss one firmware prints zeros or an old place and another the end of the move.

    Args:
        pushed: what the controller pushed between the line and its answer.

    Raises:
        DeviceError: there was an alarm, or no report.

    Example:
        >>> from palpate.rig.real.grbl_lines import parse_line
        >>> probed([parse_line(b"[PRB:0.000,0.000,-0.872:1]")])
        (0.0, 0.0, -0.872)
    """
    report: Probe | None = None
    for line in pushed:
        if isinstance(line, Alarm):
            raise DeviceError(f"the probing move ended with {alarm_name(line.code)}; see to the probe")
        if isinstance(line, Probe):
            report = line
    if report is None or len(report.machine_mm) < len("XYZ"):
        raise DeviceError(
            "the controller did not report the outcome of the probing move; check the probe input"
        )
    return report.machine_mm[:3] if report.hit else None  # type: ignore[return-value]

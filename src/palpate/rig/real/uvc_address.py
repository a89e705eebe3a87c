"""Where a USB camera is, by the name one knows it by."""

from __future__ import annotations

from pathlib import Path

from palpate.core.errors import DeviceError

BY_ID = Path("/dev/v4l/by-id")


def device(address: str | int, by_id: Path = BY_ID) -> str | int:
    """What to open for an address.

    Args:
        address: a number, a path such as ``/dev/video2``, or the serial number that the camera tells over
            USB. Only the last stays with the camera when cables are swapped.
        by_id: where the system lists cameras by serial number.

    Raises:
        DeviceError: no camera, or more than one, has this serial number.
    """
    if isinstance(address, int) or "/" in address:
        return address
    found = [path for path in _cameras(by_id) if path.name.endswith(f"_{address}-video-index0")]
    if len(found) != 1 or not address:
        there = ", ".join(path.name for path in _cameras(by_id)) or "none"
        raise DeviceError(
            f"{len(found)} cameras have the serial number {address!r}; {by_id} lists: {there}. "
            "Give one of these serial numbers, a path such as /dev/video0, or a number"
        )
    return str(found[0].resolve())


def _cameras(by_id: Path) -> list[Path]:
    return sorted(by_id.glob("*-video-index0"))

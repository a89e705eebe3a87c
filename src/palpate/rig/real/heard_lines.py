"""What a port said, in words, where it was not what its driver knows: which other device speaks so.

Recognises what palpate itself can drive, and a modem or cable that sends back what it is sent.
"""

from __future__ import annotations

import re

KEPT_BYTES = 400  # of what was heard last
SHOWN = 60  # characters
_GRBL = re.compile(rb"grbl(?:hal)? \d|<(?:Idle|Alarm|Run|Jog|Hold|Door|Check|Home|Sleep)\b", re.IGNORECASE)
_GRBL_ERROR = re.compile(rb"^error:\d{1,3}\r?$", re.MULTILINE)
_MARLIN = re.compile(rb"marlin|echo:|FIRMWARE_NAME|^start\r?$| Count X:", re.IGNORECASE | re.MULTILINE)
_WEIGHT = re.compile(rb"[A-Z, ]*[-+]? *\d+(?:\.\d+)? *[A-Za-z]{0,3} *")


class HeardTail:
    """The last bytes that were heard, and the last that were sent."""

    def __init__(self) -> None:
        self.heard, self.sent = b"", b""

    def hear(self, data: bytes) -> None:
        """Keep what came."""
        self.heard = (self.heard + data)[-KEPT_BYTES:]

    def send(self, data: bytes) -> None:
        """Keep what went out."""
        self.sent = (self.sent + data)[-KEPT_BYTES:]

    def in_words(self) -> str:
        """Words for what it said, and for who speaks so."""
        return describe_heard(self.heard, self.sent)


def describe_heard(heard: bytes, sent: bytes = b"") -> str:
    r"""Say what was heard, and who speaks so.

    Args:
        heard: the last bytes that came.
        sent: the last that were sent before.

    Example:
        >>> print(describe_heard(b"Grbl 1.1h ['$' for help]\r\n"))
        it said "Grbl 1.1h ['$' for help]": that is a GRBL controller
        >>> describe_heard(b"")
        'it said nothing'
    """
    if not heard.strip(b"\0\r\n \t"):
        return "it said nothing"
    who = _speaker(heard, sent)
    lines = [line for line in heard.replace(b"\r", b"\n").split(b"\n") if line.strip()]
    text = lines[-1].decode("ascii", "backslashreplace").strip()
    shown = text if len(text) <= SHOWN else text[:SHOWN] + "..."
    return f"it said {shown!r}{f': that is {who}' if who else ''}"


def _speaker(heard: bytes, sent: bytes) -> str:
    if _GRBL.search(heard) or _GRBL_ERROR.search(heard):
        return "a GRBL controller"
    if _MARLIN.search(heard):
        return "a Marlin controller"
    if sent and _without_ends(heard) in _without_ends(sent):
        return "what it was sent: a modem or a bridged cable sends it back"
    lines = [
        line for line in heard.replace(b"\r", b"\n").split(b"\n")[1:] if line.strip()
    ]  # the first is cut
    if any(_WEIGHT.fullmatch(line) for line in lines[-3:]):
        return "a scale, or another device that prints numbers"
    if any(byte >= 0x80 for byte in heard):
        return "no plain text: another baud rate, or another device"
    return ""


def _without_ends(data: bytes) -> bytes:
    return data.replace(b"\r", b"").replace(b"\n", b"")

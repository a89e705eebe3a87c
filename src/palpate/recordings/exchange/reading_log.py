"""A log of live readings as an MCAP file: one JSON message a reading, a channel a source, with its schema.

Foxglove Studio and the mcap tools read it. Times are the host's, since 1970; a log that was cut off is read
up to the cut.
"""

from __future__ import annotations

import json
import os
import re
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mcap.writer import Writer

from palpate.core import Closing, ExistsError, PathText, storage_errors
from palpate.version import __version__

CHUNK_BYTES = 64 * 1024  # about a second of readings, so that little is lost by a kill
SCHEMA = {
    "title": "palpate.LiveReading",
    "type": "object",
    "properties": {
        "frame": {"type": "string"},
        "number": {"type": "integer"},
        "time_s": {"type": "number", "description": "time of the frame by its source [s]"},
        "latency_ms": {"type": "number", "description": "from the frame's arrival to its readings"},
        "calibration": {"type": ["string", "null"]},
        "force_N": {"type": ["number", "null"], "description": "of a force sensor beside the camera"},
        "readings": {
            "type": "object",
            "additionalProperties": {
                "type": "object",
                "properties": {
                    "value": {"type": ["number", "object", "null"]},
                    "low": {"type": ["number", "null"]},
                    "high": {"type": ["number", "null"]},
                    "unit": {"type": "string"},
                    "valid": {"type": "boolean"},
                    "why": {"type": "string"},
                    "code": {"type": "string"},
                    "drift": {"type": ["object", "null"]},
                },
            },
        },
    },
}


class ReadingLog(Closing):
    """An MCAP file of readings that is being written.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder, ReadingLog(Path(folder, "live.mcap")) as log:
        ...     log.write("virtual:palm", {"frame": "0", "readings": {}})
    """

    def __init__(self, path: PathText) -> None:
        self._path = Path(path)
        with storage_errors(self._path):
            try:
                self._file = self._path.open("xb")
            except FileExistsError as e:
                raise ExistsError(f"{path} exists, and nothing is overwritten; name another file") from e
        self._writer = Writer(self._file, chunk_size=CHUNK_BYTES)
        self._channels: dict[str, int] = {}
        self._closed = False
        with storage_errors(self._path):
            self._writer.start("", f"palpate {__version__}")
            self._schema = self._writer.register_schema(
                str(SCHEMA["title"]),
                "jsonschema",
                json.dumps(SCHEMA).encode(),
            )

    def write(self, source: str, reading: Mapping[str, Any], time_ns: int | None = None) -> None:
        """Write what was read.

        Args:
            time_ns: when it was read, since 1970; now where left out [ns].
        """
        at_ns = time.time_ns() if time_ns is None else time_ns
        with storage_errors(self._path):
            if source not in self._channels:
                self._channels[source] = self._writer.register_channel(
                    f"/palpate/{re.sub('[^A-Za-z0-9]+', '_', source).strip('_')}/readings",
                    "json",
                    self._schema,
                    {"source": source},
                )
            data = json.dumps(reading, allow_nan=False).encode()
            self._writer.add_message(self._channels[source], at_ns, data, at_ns)

    def close(self) -> None:
        """Write the index and close the file. Closing again does nothing."""
        if not self._closed:
            self._closed = True
            with storage_errors(self._path):
                self._writer.finish()
                self._file.close()

    def discard(self) -> None:
        """Close the file and remove it, as one in which there is nothing to read."""
        with storage_errors(self._path):
            made = os.fstat(self._file.fileno())
            self.close()
            if self._path.exists() and os.path.samestat(made, self._path.stat()):
                self._path.unlink()

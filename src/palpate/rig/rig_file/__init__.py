"""A rig's TOML file: its tables, read, checked and opened."""

from palpate.rig.rig_file.motion_parts import MAX_LIMITS, LimitsPart
from palpate.rig.rig_file.opened_rig import (
    RigFile,
    is_virtual,
    open_part,
    open_rig,
    read_rig,
    rig_from,
    sensor_named,
)
from palpate.rig.rig_file.stage_parts import GrblPart, MarlinPart

__all__ = [
    "MAX_LIMITS",
    "GrblPart",
    "LimitsPart",
    "MarlinPart",
    "RigFile",
    "is_virtual",
    "open_part",
    "open_rig",
    "read_rig",
    "rig_from",
    "sensor_named",
]

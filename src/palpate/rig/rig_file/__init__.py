"""A rig's TOML file: its tables, read, checked and opened."""

from palpate.rig.rig_file.opened_rig import (
    RigFile,
    follow_stage,
    is_virtual,
    open_part,
    open_rig,
    read_rig,
    rig_from,
    sensor_named,
)
from palpate.rig.rig_file.sensor_parts import FollowingPart
from palpate.rig.rig_file.stage_parts import (
    MAX_LIMITS,
    GrblPart,
    LimitsPart,
    MarlinPart,
    PositionFrom,
    UrArmPart,
)

__all__ = [
    "MAX_LIMITS",
    "FollowingPart",
    "GrblPart",
    "LimitsPart",
    "MarlinPart",
    "PositionFrom",
    "RigFile",
    "UrArmPart",
    "follow_stage",
    "is_virtual",
    "open_part",
    "open_rig",
    "read_rig",
    "rig_from",
    "sensor_named",
]

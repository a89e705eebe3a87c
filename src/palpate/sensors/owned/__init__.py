"""Sensors that people own: published properties with sources, and files for one's own."""

from palpate.sensors.owned.sensor_preset import (
    CameraAdvice,
    FrameMode,
    MarksInSkin,
    PresetFact,
    SensorPreset,
    SkinInFrame,
    preset_names,
    read_preset,
    recognised_preset,
    sensor_preset,
    write_own_preset,
)

__all__ = [
    "CameraAdvice", "FrameMode", "MarksInSkin", "PresetFact", "SensorPreset", "SkinInFrame", "preset_names",
    "read_preset", "recognised_preset", "sensor_preset", "write_own_preset",
]  # fmt: skip

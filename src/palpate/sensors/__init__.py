"""One file a sensor design: its numbers, and the mechanics and optics it uses."""

from palpate.sensors.half_space import HalfSpaceSpec, debug, demo, press, render, render_clean, render_plain

__all__ = ["HalfSpaceSpec", "debug", "demo", "press", "render", "render_clean", "render_plain"]

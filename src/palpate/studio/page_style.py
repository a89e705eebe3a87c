"""Style of the pages: the reports' colours on quiet ground, system fonts, nothing from elsewhere."""

from __future__ import annotations

from importlib import resources

INK, ACCENT, BAND, BAD = "#1b2a33", "#0b7a75", "#cfe8e6", "#c0392b"
"""The reports' colours."""
SOFT, LINE, GROUND, WARN = "#5b6b75", "#d9e0e4", "#f4f6f7", "#855900"
AXES = {"x": "#b0642b", "y": "#5b6fb5", "z": ACCENT}
"""Colours of the force: the normal one is the accent."""
COLOURS = {
    "ink": INK, "accent": ACCENT, "band": BAND, "bad": BAD,
    "soft": SOFT, "line": LINE, "ground": GROUND, "warn": WARN,
}  # fmt: skip


def style() -> str:
    """The pages' CSS: `look.css`, and its colours by name."""
    named = "; ".join(f"--{name}: {colour}" for name, colour in COLOURS.items())
    return f":root {{ {named} }}\n{text_of('look.css')}"


def text_of(name: str) -> str:
    """A file of this folder."""
    return resources.files("palpate.studio").joinpath(name).read_text(encoding="utf-8")

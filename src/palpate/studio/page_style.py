"""Style of the pages: the reports' colours, light and dark, system fonts, nothing from elsewhere."""

from __future__ import annotations

from importlib import resources

from palpate.core import InputError

INK, ACCENT, BAND, BAD = "#1b2a33", "#0b7a75", "#cfe8e6", "#c0392b"
"""The reports' colours."""
SOFT, LINE, GROUND, WARN = "#5b6b75", "#d9e0e4", "#f4f6f7", "#855900"
LIGHT = {
    "ink": INK, "accent": ACCENT, "band": BAND, "bad": BAD, "soft": SOFT, "line": LINE, "ground": GROUND,
    "warn": WARN, "card": "#ffffff", "alarm": BAD, "alarm-edge": "#7d1f14", "held": "#fbe9e7",
    "held-ink": "#7d1f14", "notice": "#fdf0d2", "on-fill": "#ffffff", "fill": ACCENT,
    "axis-x": "#b0642b", "axis-y": "#5b6fb5", "axis-z": ACCENT,
}  # fmt: skip
"""Colours by name where the page is light."""
DARK = {
    "ink": "#e8eef1", "accent": "#4cc2ba", "band": "#1f4a4b", "bad": "#ff9a8c", "soft": "#a9b8c1",
    "line": "#34434c", "ground": "#10181d", "warn": "#f0c25a", "card": "#182229", "alarm": BAD,
    "alarm-edge": "#f2b3aa", "held": "#4a1f1a", "held-ink": "#ffd9d3", "notice": "#43361a",
    "on-fill": "#ffffff", "fill": ACCENT, "axis-x": "#e59a5f", "axis-y": "#9db0f2", "axis-z": "#4cc2ba",
}  # fmt: skip
"""The same where it is dark. What is filled keeps its colour, so that white text on it stays as readable."""


def paint(name: str) -> str:
    """A colour of the theme that is shown, as drawings and styles name it."""
    if name not in LIGHT:
        raise InputError(f"no colour is called {name!r}; there are {', '.join(LIGHT)}")
    return f"var(--{name})"


AXES = {axis: paint(f"axis-{axis}") for axis in "xyz"}
"""Colours of the force: the normal one is the accent."""


def style() -> str:
    """The pages' CSS: `look.css`, and its colours by name for both themes."""
    light, dark = (
        "; ".join(f"--{name}: {colour}" for name, colour in colours.items()) for colours in (LIGHT, DARK)
    )
    return (
        f":root {{ color-scheme: light; {light} }}\n"
        f":root[data-theme=dark] {{ color-scheme: dark; {dark} }}\n{text_of('look.css')}"
    )


def text_of(name: str) -> str:
    """A file of this folder."""
    return resources.files("palpate.studio").joinpath(name).read_text(encoding="utf-8")

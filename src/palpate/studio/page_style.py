"""Style of the pages: the reports' ink and accent on quiet ground, system fonts, nothing from elsewhere."""

from __future__ import annotations

from importlib import resources

from palpate.studio import palette

COLOURS = ("INK", "ACCENT", "BAND", "BAD", "SOFT", "LINE", "GROUND", "WARN")


def style() -> str:
    """The pages' CSS: `look.css`, and its colours by name."""
    named = "; ".join(f"--{name.lower()}: {getattr(palette, name)}" for name in COLOURS)
    return f":root {{ {named} }}\n{text_of('look.css')}"


def text_of(name: str) -> str:
    """A file of this folder."""
    return resources.files("palpate.studio").joinpath(name).read_text(encoding="utf-8")

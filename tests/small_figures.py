"""Figures not drawn, or drawn small, for tests that ask whether a picture is there, not how it looks."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

import pytest

PNG = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAAAAAA6fptVAAAACklEQVR4nGNgAAAAAgABSK+kcQAAAABJRU5ErkJggg=="
)
SVG = '<svg width="1pt" height="1pt" viewBox="0 0 1 1"></svg>'


def saved_blank(figure: Any, to: Any, **how: Any) -> None:
    """One pixel in place of a figure: to arrange and draw one takes up to a second."""
    if not hasattr(to, "write"):
        Path(to).write_bytes(PNG)
    else:
        to.write(SVG if how.get("format") == "svg" else PNG)


@pytest.fixture
def figures_blank(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make figures, and draw none."""
    monkeypatch.setattr("matplotlib.figure.Figure.savefig", saved_blank)


@pytest.fixture
def figures_small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw figures at a low resolution and without arranging them."""
    from matplotlib.figure import Figure

    draw = Figure.savefig

    def savefig(figure: Figure, to: Any, **how: Any) -> None:
        figure.set_layout_engine("none")
        draw(figure, to, **{**how, "dpi": 20})

    monkeypatch.setattr(Figure, "savefig", savefig)

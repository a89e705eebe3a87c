"""The reports' colours, and those that a page needs beyond them."""

INK, ACCENT, BAND, BAD = "#1b2a33", "#0b7a75", "#cfe8e6", "#c0392b"
SOFT, LINE, GROUND, WARN = "#5b6b75", "#d9e0e4", "#f4f6f7", "#9a6700"
AXES = {"x": "#b0642b", "y": "#5b6fb5", "z": ACCENT}
"""Colours of the force: the normal one is the accent."""

"""Compliance by a TacTip's pins on the virtual sensor: controls, and equation (3) itself."""

"""Copies of the palm: constants found from a few presses of known force, presses read, weights checked."""

"""Verbs of softness played back to a finger: displays, trials, what is transmitted."""

__all__: list[str] = []

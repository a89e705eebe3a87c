"""Verbs that record: the wizard, rigs, runs and what is imported."""

__all__: list[str] = []

"""Verbs that read: live and stored frames, softness, fringes, copies of palms and tips."""

__all__: list[str] = []

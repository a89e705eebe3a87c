"""Real devices of softness: an arm, a contact-area display."""

__all__: list[str] = []

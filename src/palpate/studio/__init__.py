"""Pages in the browser: they show, and pass on what is asked for. No physics, no hardware loop."""

__all__: list[str] = []

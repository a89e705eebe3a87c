"""Pages in the browser: they show, and pass on what is asked for. No physics, no hardware loop."""

from palpate.core.optional_imports import check_installed

__all__: list[str] = []

check_installed("nicegui", "`palpate studio`")

"""Published studies reproduced on virtual sensors, a folder a paper: setup, conditions, comparison, page."""

__all__: list[str] = []

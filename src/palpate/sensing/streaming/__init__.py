"""Parts of the live loop: files played, readers, hand-overs, statistics, drift, and its subscribers."""

__all__: list[str] = []

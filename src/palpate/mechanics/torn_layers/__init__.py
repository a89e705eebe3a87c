"""Layers with a cut from above, which waves cannot have: finite elements across it, waves along it.

`strip_elements` has the elements, `cut_opening` what a jump on the cut does, and the jump that a
load makes. Each is asked for by its path.
"""

__all__: list[str] = []

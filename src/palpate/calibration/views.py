"""Which parts of a frame a model of two views sees, where nobody says so."""

from __future__ import annotations

from palpate.core.errors import InputError
from palpate.recordings.manifest import Manifest

Box = tuple[int, int, int, int]
FRINGES, MIRROR = "fringes", "mirror"


def two_views(manifest: Manifest) -> tuple[Box, Box]:
    """The fringes' and the mirror's region, as the run names them.

    Raises:
        InputError: it does not name both.
    """
    regions = manifest.regions
    if not (FRINGES in regions and MIRROR in regions):
        named = ", ".join(regions) or "none"
        raise InputError(
            f"this model sees two parts of a frame, {FRINGES} and {MIRROR}, and the run names {named}; "
            "give --crop X,Y,WIDTH,HEIGHT twice, the fringes first"
        )
    return regions[FRINGES], regions[MIRROR]

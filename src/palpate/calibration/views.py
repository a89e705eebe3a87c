"""Which parts of a frame a model sees, where nobody says so: the regions that it was made for."""

from __future__ import annotations

from palpate.core.errors import InputError
from palpate.recordings.manifest import Manifest

Box = tuple[int, int, int, int]


def regions_seen(manifest: Manifest, names: tuple[str, ...]) -> tuple[Box, ...]:
    """The regions of these names, in their order.

    Args:
        manifest: of the run, which names its regions.
        names: of a model's regions, see `estimators.networks.Kind`.

    Raises:
        InputError: the run does not name all of them.
    """
    regions = manifest.regions
    if not set(names) <= set(regions):
        named = ", ".join(regions) or "none"
        raise InputError(
            f"this model sees two parts of a frame, {' and '.join(names)}, and the run names {named}; "
            f"give --crop X,Y,WIDTH,HEIGHT twice, the {names[0]} first"
        )
    return tuple(regions[name] for name in names)

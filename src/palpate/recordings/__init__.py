"""Recordings on disk: runs written, read, repaired, checked, packed, split, imported and exported.

The names here load when they are first used, so that reading one image loads no table. Whatever reads or
writes a file raises `StorageError` where the disk is full or refuses.
"""

from typing import TYPE_CHECKING

from palpate.core.plugins import names_at_first_use

if TYPE_CHECKING:
    from palpate.recordings.clock_offset import Offset, mean_over_exposures, offset_between
    from palpate.recordings.exchange.image_files import read_image
    from palpate.recordings.exchange.image_import import ImportReport, import_images
    from palpate.recordings.exchange.press_export import export_folder
    from palpate.recordings.integrity import CheckReport, RepairReport, check, repair
    from palpate.recordings.label_tables import read_labels
    from palpate.recordings.manifest import Manifest
    from palpate.recordings.packed_set import PackedSet, pack
    from palpate.recordings.run_reader import Run
    from palpate.recordings.run_writer import RunWriter
    from palpate.recordings.splits import Split, split

_MODULES = {
    name: module
    for module, names in {
        "clock_offset": ("Offset", "mean_over_exposures", "offset_between"),
        "exchange.press_export": ("export_folder",),
        "exchange.image_files": ("read_image",),
        "exchange.image_import": ("ImportReport", "import_images"),
        "integrity": ("CheckReport", "RepairReport", "check", "repair"),
        "label_tables": ("read_labels",),
        "manifest": ("Manifest",),
        "packed_set": ("PackedSet", "pack"),
        "run_reader": ("Run",),
        "run_writer": ("RunWriter",),
        "splits": ("Split", "split"),
    }.items()
    for name in names
}

__all__ = [
    "CheckReport",
    "ImportReport",
    "Manifest",
    "Offset",
    "PackedSet",
    "RepairReport",
    "Run",
    "RunWriter",
    "Split",
    "check",
    "export_folder",
    "import_images",
    "mean_over_exposures",
    "offset_between",
    "pack",
    "read_image",
    "read_labels",
    "repair",
    "split",
]

if not TYPE_CHECKING:  # mypy accepts only the names imported above
    __getattr__, __dir__ = names_at_first_use(__name__, _MODULES, __all__)

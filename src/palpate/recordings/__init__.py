"""What is on disk: runs written and read, repaired and checked, packed, split, imported and exported.

The names here load when they are first used, so that reading one image loads no table. A function named
as its module is imported from there: `from palpate.recordings.check import check`.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from palpate.recordings.align import Offset, offset_between
    from palpate.recordings.check import CheckReport
    from palpate.recordings.exporters.folder import export_folder
    from palpate.recordings.images import read_image
    from palpate.recordings.importers.images import ImportReport, import_images
    from palpate.recordings.importers.palm import import_palm
    from palpate.recordings.labels import read_labels
    from palpate.recordings.manifest import Manifest
    from palpate.recordings.pack import PackedSet
    from palpate.recordings.reader import Run
    from palpate.recordings.repair import RepairReport
    from palpate.recordings.splits import Split, split
    from palpate.recordings.writer import RunWriter

_MODULES = {
    "export_folder": "exporters.folder",
    "import_images": "importers.images",
    "import_palm": "importers.palm",
    "offset_between": "align",
    "read_image": "images",
    "read_labels": "labels",
    "split": "splits",
    "CheckReport": "check",
    "ImportReport": "importers.images",
    "Manifest": "manifest",
    "Offset": "align",
    "PackedSet": "pack",
    "RepairReport": "repair",
    "Run": "reader",
    "RunWriter": "writer",
    "Split": "splits",
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
    "export_folder",
    "import_images",
    "import_palm",
    "offset_between",
    "read_image",
    "read_labels",
    "split",
]


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return getattr(import_module(f"palpate.recordings.{_MODULES[name]}"), name)
    raise AttributeError(f"palpate.recordings has no {name!r}; it has {', '.join(__all__)}")


def __dir__() -> list[str]:
    return __all__

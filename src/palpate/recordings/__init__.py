"""What is on disk: runs written and read, repaired and checked, packed, split, imported and exported."""

from palpate.recordings.align import Offset, offset_between
from palpate.recordings.check import CheckReport, check
from palpate.recordings.exporters.folder import export_folder
from palpate.recordings.images import read_image
from palpate.recordings.importers.images import ImportReport, import_images
from palpate.recordings.importers.palm import import_palm
from palpate.recordings.labels import read_labels
from palpate.recordings.manifest import Manifest
from palpate.recordings.pack import PackedSet, pack
from palpate.recordings.reader import Run
from palpate.recordings.repair import RepairReport, repair
from palpate.recordings.splits import Split, split
from palpate.recordings.writer import RunWriter

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
    "import_palm",
    "offset_between",
    "pack",
    "read_image",
    "read_labels",
    "repair",
    "split",
]

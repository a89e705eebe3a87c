"""What other people's recordings look like, one file a layout, each turned into a run.

`images` reads a folder of single images with a table of labels. A layout that stores its frames otherwise (a
multi-page TIFF, a video, one sensor's own folder tree) is a file of its own here, whose one public function
has the same shape: where the recording is, where the run shall be, what cannot be read from the files, and a
report of what was imported.
"""

from palpate.recordings.importers.images import ImportReport, import_images

__all__ = ["ImportReport", "import_images"]

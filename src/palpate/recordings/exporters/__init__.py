"""Runs written for other tools to read, one file a layout."""

from palpate.recordings.exporters.folder import export_folder

__all__ = ["export_folder"]

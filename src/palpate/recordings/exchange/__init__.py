"""Layouts of other tools, each a file: images, TIFF, video, tables of a press, plain folders.

A layout that is imported has one public function of the same shape: where the recording is, where the run
shall be, what cannot be read from the files, and a report of what was imported.
"""

__all__: list[str] = []

"""Packages on the path, as an installer lays them."""

import importlib
from pathlib import Path


def lay_package(folder: Path, package: str, group: str, name: str, value: str) -> None:
    """Write the metadata of a package with one entry point."""
    info = folder / f"{package}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[{group}]\n{name} = {value}\n")
    importlib.invalidate_caches()

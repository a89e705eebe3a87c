"""Presses of a run go into a folder for every specimen at every tilt, none over another."""

from __future__ import annotations

import json
import math
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pandas as pd
import pytest

from palpate.recordings.exchange.press_export import export_presses
from palpate.recordings.run_reader import Run

FRAMES = 3


def run_on(path: Path, *indenters: str) -> Run:
    """What the export reads of a run that pressed each indenter once."""
    count = FRAMES * len(indenters)
    times_s = 0.1 * np.arange(count) + 1.0
    labels = pd.DataFrame(
        {
            "phase": "sweep",
            "indenter": np.repeat(indenters, FRAMES),
            "location": "r1c1",
            "approach": np.repeat(np.arange(len(indenters)), FRAMES),
            "cycle": 1,
        }
    )
    at_s = np.arange(0.0, times_s[-1] + 1.0, 0.01)
    made = Mock(spec=Run, path=path, labels=labels, times_s=times_s)
    made.events.return_value = pd.DataFrame({"kind": ["clocks"], "fields": [json.dumps({"seconds": 0.0})]})
    made.force.return_value = pd.DataFrame({"time_s": at_s, "fz_N": at_s})
    made.stage.return_value = pd.DataFrame({"time_s": at_s, "z_m": 1e-3 * at_s})
    made.frame.side_effect = lambda i: SimpleNamespace(image=np.full((4, 4), i, np.uint8))
    return made


@pytest.mark.parametrize(
    ("indenters", "expected"),
    [
        (
            ("S1=7.6@20", "S1=7.6@12.5", "rigid@20"),
            {"S1-20deg": 7.6, "S1-12.5deg": 7.6, "rigid-20deg": math.inf},
        ),
        (("S1=7.6", "S2=3.1?", "rigid"), {"S1": 7.6, "S2": math.nan, "rigid": math.inf}),
        (("S1=7.6", "S1=5", "S1-2=3"), {"S1": 7.6, "S1-2": 5.0, "S1-2-2": 3.0}),
        (("sphere:10", "S1=7.6@aside"), {"S1": 7.6}),
    ],
)
def test_every_indenter_has_a_folder_of_its_own(
    tmp_path: Path, indenters: tuple[str, ...], expected: dict[str, float]
) -> None:
    folder = export_presses(run_on(tmp_path, *indenters), tmp_path / "presses")
    assert folder is not None
    found = {one.name: one.stiffness_n_m for one in folder.specimens}
    known = {name: math.nan if k is None else 1e-3 * k for name, k in found.items()}
    assert known == pytest.approx(expected, nan_ok=True)
    assert all([tiff.name for tiff, _ in one.presses] == ["01.tif"] for one in folder.specimens)

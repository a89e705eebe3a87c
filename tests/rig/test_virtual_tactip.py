"""The virtual rig drives the TacTip: presses on specimens come back from the run as compliance reads them."""

import math
from pathlib import Path

import numpy as np
import pytest

from palpate.calibration.compliance.compliance_calibration import ReferenceSpecimen, calibrate_compliance
from palpate.calibration.compliance.compliance_reading import read_touch
from palpate.calibration.compliance.press_cues import cues_of
from palpate.core.sensor import sensor
from palpate.recordings.exchange.frame_sequences import TiffFrames
from palpate.recordings.exchange.press_export import export_presses
from palpate.recordings.exchange.press_folder import PressFolder, press_folder
from palpate.recordings.exchange.press_table import read_press_table
from palpate.recordings.run_reader import Run
from palpate.rig import PLANS, State, record
from palpate.rig.virtual import virtual_rig

TACTIP = sensor("tactip")
FEW = PLANS["tactip"].model_copy(update={"indenters": ("rigid", "S3=1.1?"), "cycles": 1, "wait_s": 0.0})


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """One press on a rigid plate and one on the softest specimen."""
    out = tmp_path_factory.mktemp("tactip") / "run"
    rig = virtual_rig("tactip", seed=2)
    try:
        outcome = record(rig, FEW, out)
    finally:
        rig.close()
    assert outcome.state is State.DONE, outcome.message
    export_presses(Run.open(out))
    return Run.open(out)


@pytest.mark.slow
def test_force_position_and_area_of_a_press_are_those_of_its_contact(run: Run) -> None:
    for one, words in zip(press_folder(run.path).specimens, FEW.indenters, strict=True):
        tiff, path = one.presses[0]
        with TiffFrames(tiff) as pages:
            table = read_press_table(path, len(pages))
        assert 5.0 < table.force_n.max() < 5.4
        assert table.area_m2 is not None
        body = TACTIP.force_law(TACTIP.probe(words), TACTIP.specimen(words))
        at = table.frame_sample[table.force_n[table.frame_sample] > 1.0]
        law_n = np.interp(table.area_m2[at], math.pi * body.radius_m**2, body.force_n)
        # Noise of 0.02 N in steps of 1/16 N, and a force that moves on by 0.1 N while a frame is exposed.
        assert np.abs(table.force_n[at] - law_n).max() < 0.25
        assert np.abs(np.median(table.force_n[at] - law_n)) < 0.03


@pytest.mark.slow
def test_the_stiffness_of_a_specimen_is_read_from_a_recorded_run(tmp_path: Path) -> None:
    rig = virtual_rig("tactip", seed=1)
    assert record(rig, PLANS["tactip"], tmp_path / "run").state is State.DONE
    folder = export_presses(Run.open(tmp_path / "run"))
    assert folder is not None
    trials = _trials(folder)
    references = [
        ReferenceSpecimen(one.name, one.stiffness_n_m, trials[one.name])
        for one in folder.specimens
        if one.stiffness_n_m is not None
    ]
    touch = read_touch(calibrate_compliance(references), [one.press for one in trials["new"]], "new")
    assert touch.stiffness.in_unit("N_per_mm").value == pytest.approx(5.3, rel=0.03)


def _trials(folder: PressFolder):
    found = {}
    for one in folder.specimens:
        cues = []
        for tiff, path in one.presses:
            with TiffFrames(tiff) as pages:
                cues.append(cues_of(list(pages), read_press_table(path, len(pages))))
        found[one.name] = tuple(one.trial for one in cues)
    return found

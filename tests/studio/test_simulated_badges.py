"""What is simulated says so on every page that shows it, and what was measured does not."""

import numpy as np
import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed")

from tests.studio.small_run import write_small_run

from palpate.calibration import CalibrationPlan, calibrate
from palpate.calibration.certificate import read_predictions
from palpate.core import ManualClock
from palpate.core.provenance import Provenance
from palpate.estimators import read_card
from palpate.recordings import Manifest, Run, RunWriter
from palpate.studio.library.calibrations_page import heading_html
from palpate.studio.library.recordings_page import runs_table
from palpate.studio.library.workspace import Workspace
from palpate.studio.rig_page import title_html
from palpate.workflows.certification import honest_sentence

BADGE = "simulated, not measured"


@pytest.fixture
def two_runs(tmp_path):
    write_small_run(tmp_path / "pressed-by-hand", frames=3)
    write_small_run(tmp_path / "virtual-palm", frames=3, provenance=Provenance.SIMULATED)
    return Workspace(tmp_path)


def test_each_simulated_run_of_the_list_is_called_so_and_no_measured_one(two_runs) -> None:
    rows = runs_table([two_runs.summary(name) for name in two_runs.found("run")]).split("<tr>")[2:]
    assert {row.split("</a>")[0].rpartition(">")[2]: BADGE in row for row in rows} == {
        "pressed-by-hand": False,
        "virtual-palm": True,
    }


@pytest.mark.parametrize("simulated", [True, False])
def test_the_rigs_page_says_of_a_virtual_rig_that_it_is_simulated(simulated) -> None:
    status = {"rig": "bench <3>", "real_time": True, "simulated": simulated}
    assert (BADGE in title_html(status)) == simulated
    assert "bench &lt;3&gt;" in title_html(status)


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory, changes_untried):
    """Two calibrations of virtual presses: of images that show the force, and of images that show nothing."""
    folder, rng = tmp_path_factory.mktemp("calibrated"), np.random.default_rng(0)
    plan = CalibrationPlan(targets=("force_N",), split="group:press", model="pca-ridge", size_px=(6, 8))
    manifest = Manifest.new(
        sensor="s",
        labels={"force_N": "number", "press": "text"},
        targets=("force_N",),
        provenance=Provenance.SIMULATED,
    )
    for name, shown in (("told", 20.0), ("untold", 0.0)):
        clock = ManualClock()
        with RunWriter.create(folder / f"{name}-run", manifest, clock=clock, overflow="wait") as writer:
            for i, force_n in enumerate(np.repeat(rng.uniform(1.0, 10.0, 20), 3)):
                image = rng.normal(30.0 + shown * force_n, 2.0, (24, 32)).clip(0, 255).astype(np.uint8)
                writer.frame(image, labels={"force_N": float(force_n), "press": f"p{i // 3}"})
                clock.sleep(0.1)
        calibrate(Run.open(folder / f"{name}-run"), plan, folder / name)
    return Workspace(folder)


def test_a_calibration_learnt_from_a_virtual_sensor_is_called_simulated_and_a_measured_one_is_not(
    calibrated,
) -> None:
    card = calibrated.card("told")
    assert BADGE in heading_html("told", card, False)
    measured = card.run.model_copy(update={"provenance": Provenance.MEASURED})
    by_hand = card.model_copy(update={"run": measured})
    assert BADGE not in heading_html("told", by_hand, False)
    mixed = card.sessions.model_copy(update={"runs": (measured, card.run)})
    assert BADGE in heading_html("told", by_hand.model_copy(update={"sessions": mixed}), False)


def test_a_calibration_of_presses_that_its_session_calls_useless_is_called_unsure_and_no_other(
    calibrated,
) -> None:
    for name, useless in (("told", False), ("untold", True)):
        card = read_card(calibrated.folder / name)
        sentence = honest_sentence(card, read_predictions(calibrated.folder / name, card), 20)
        assert sentence.startswith("Useless") == useless
        assert calibrated.is_useless(name, card) == useless
        found = heading_html(name, card, calibrated.is_useless(name, card))
        assert ("surely better" in found) == useless
    by_session = card.split.model_copy(update={"columns": ("session",)})
    assert not calibrated.is_useless("untold", card.model_copy(update={"split": by_session}))

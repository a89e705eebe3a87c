"""What is simulated says so on every page that shows it, and what was measured does not."""

import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed")

from tests.studio.small_run import write_small_run

from palpate.studio.library.recordings_page import runs_table
from palpate.studio.library.workspace import Workspace
from palpate.studio.rig_page import title_html

BADGE = "simulated, not measured"
VIRTUAL_HAND = "pressed by a virtual hand; virtual, not measured"


@pytest.fixture
def two_runs(tmp_path):
    write_small_run(tmp_path / "pressed-by-hand", frames=3, origin="pressed by hand")
    write_small_run(tmp_path / "virtual-palm", frames=3, origin=VIRTUAL_HAND)
    return Workspace(tmp_path)


def test_each_simulated_run_of_the_list_is_called_so_and_no_measured_one(two_runs) -> None:
    rows = runs_table([two_runs.summary(name) for name in two_runs.found("run")]).split("<tr>")[2:]
    assert {row.split("</a>")[0].rpartition(">")[2]: BADGE in row for row in rows} == {
        "pressed-by-hand": False,
        "virtual-palm": True,
    }


def test_a_run_that_cannot_be_opened_is_not_called_simulated(two_runs) -> None:
    (two_runs.folder / "virtual-palm" / "manifest.json").write_text("{")
    for one in (two_runs.folder / "virtual-palm").glob("*.mcap"):
        one.unlink()
    found = two_runs.summary("virtual-palm")
    assert found.state == "damaged"
    assert BADGE not in runs_table([found])


@pytest.mark.parametrize("simulated", [True, False])
def test_the_rigs_page_says_of_a_virtual_rig_that_it_is_simulated(simulated) -> None:
    status = {"rig": "bench <3>", "real_time": True, "simulated": simulated}
    assert (BADGE in title_html(status)) == simulated
    assert "bench &lt;3&gt;" in title_html(status)

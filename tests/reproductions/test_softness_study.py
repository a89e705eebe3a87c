"""The softness report's study: golden radii, the specimens' idea, the tracking and its controls."""

import json
from pathlib import Path
from typing import Any

import pytest

from palpate.core import ExistsError
from palpate_reproductions.softness import reproduce_softness

pytestmark = pytest.mark.slow  # the whole study; its laws, loop, servo and observers have quick tests


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("study") / "softness"
    reproduce_softness(out)
    return out


@pytest.fixture(scope="module")
def found(study: Path) -> dict[str, Any]:
    return {one["name"]: one for one in json.loads((study / "summary.json").read_text())}


@pytest.mark.parametrize(
    ("kpa", "b_mm", "d_mm"), [(7, 2.74, 15.68), (20, 3.21, 8.68), (33, 3.73, 6.22), (100, 7.32, 3.00)]
)
def test_the_pairs_of_figure_3_have_their_golden_radii(found, kpa: int, b_mm: float, d_mm: float) -> None:
    for names, golden in (("A and B", b_mm), ("C and D", d_mm)):
        one = found[f"{names}: radius of the other, finger {kpa} kPa"]
        assert one["value"] == pytest.approx(golden, abs=0.01)
    assert found["A and B: radius of the other, finger 100 kPa"]["published"] == 7.3


def test_pairs_alike_under_one_finger_are_not_under_another(found) -> None:
    for names, cue, ratio in (("A and B", "kinesthetic", 1 / 0.7333), ("C and D", "cutaneous", 1 / 0.4545)):
        name = f"{names}: force of the other over the one, {cue} cue, finger 20 kPa"
        assert found[name]["value"] == pytest.approx(ratio, rel=1e-3)


def test_a_plate_above_leaves_one_area_and_mirrored_pairs_differ_in_area_more_than_in_way(found) -> None:
    def spread(kind: str, said: str) -> float:
        return found[f"{kind}: greatest over least {said} at 0.6 N, less 1"]["value"]

    assert spread("CL2", "area") == pytest.approx(0.0, abs=1e-9)
    assert spread("CL2", "displacement") > 0.1
    assert spread("CL3", "area") > 3 * spread("CL3", "displacement")
    assert spread("CL1", "area") > spread("CL3", "area")


def test_the_bench_follows_both_cues_and_a_pid_follows_worse(found) -> None:
    def off(name: str, cue: str) -> float:
        return found[f"{name}: force over {cue}, RMS of the peak"]["value"]

    for name in ("ball, 1 Hz", "ball, 3 Hz", "line, 1 Hz", "line, 3 Hz"):
        assert off(name, "area") < 5
        assert off(name, "displacement") < 3
    for f in (3, 5):
        assert off(f"ball, {f} Hz, PID", "area") > 1.15 * off(f"ball, {f} Hz", "area")
    moved = found["line: another displacement curve moves force over area by, of the peak"]["value"]
    assert moved < 1.0


def test_the_pressure_is_fast_by_both_servos_and_small_changes_are_lost_where_the_overlap_is_not_known(
    found,
) -> None:
    for servo in ("model of the flow", "PID"):
        for kpa in (2, 15):
            assert 80 < found[f"pressure by {servo}, {kpa} kPa: -3 dB at"]["value"] < 180
    name = "pressure by model with half the valve's overlap, 2 kPa: -3 dB at"
    assert found[name]["value"] < 10


def test_the_page_says_what_is_assumed_and_nothing_is_overwritten(study: Path) -> None:
    page = (study / "report.html").read_text()
    assert "are assumed" in page
    assert page.count("<img") == 4 + 3 + 2 + 13 + 3
    assert "not printed" in page
    with pytest.raises(ExistsError):
        reproduce_softness(study)

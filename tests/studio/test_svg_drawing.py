"""What the pages draw and say, without a browser."""

import re
from xml.etree import ElementTree

import pytest

from palpate.core import Outline
from palpate.rig.plans import PLANS, plan_from
from palpate.studio import page_shell, status_text, svg_drawing

SVG = "{http://www.w3.org/2000/svg}"
PALM = Outline.disc(57e-3)


def parsed(text):
    return ElementTree.fromstring(text.replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1))


def test_each_place_is_a_circle_as_wide_as_the_probe_and_none_leaves_the_layer():
    plan = PLANS["palm"]
    places = plan.places.places()
    circles = list(parsed(svg_drawing.grid_svg(places, PALM, 10.0)).iter(f"{SVG}circle"))
    probes = [c for c in circles if c.get("r") == "5.000" and c.find(f"{SVG}title") is not None]
    assert len(probes) == 37
    for circle in probes:
        assert (float(circle.get("cx")) ** 2 + float(circle.get("cy")) ** 2) ** 0.5 + 5.0 <= 28.5 + 1e-6


def test_the_clearance_is_what_is_left_between_the_probe_and_the_rim():
    # The outermost places of the palm's grid lie 3 pitches of 7 mm across and 1 along: 22.136 mm out.
    assert status_text.clearance_mm(PLANS["palm"]) == pytest.approx(23.5 - 7 * 10**0.5)
    plan = plan_from({"places": {"kind": "listed", "at_mm": [[23.5, 0.0]]}})
    assert status_text.clearance_mm(plan) == pytest.approx(0.0)


def test_a_name_cannot_become_markup():
    from palpate.rig.plans import Place

    text = svg_drawing.grid_svg([Place("<script>&", 0, 0)], PALM, 10.0, now="<script>&")
    assert "<script>" not in text
    assert parsed(text) is not None
    boxes = svg_drawing.regions_svg([{"name": "<b>", "box_px": [0, 0, 8, 8]}], (16, 8))
    assert "<b>" not in boxes


@pytest.mark.parametrize("scale", [0.0, 1e-3, 0.3, 16.0, 3000.0])
def test_the_force_stays_inside_its_axes_whatever_its_size(scale):
    series = {
        "age_s": [20.0, 10.0, 0.0],
        "x": [0.0, -scale, 0.0],
        "y": [0.0] * 3,
        "z": [0.0, 2 * scale, scale],
    }
    lines = list(parsed(svg_drawing.force_svg(series)).iter(f"{SVG}polyline"))
    assert len(lines) == 3
    for line in lines:
        for x, y in (map(float, point.split(",")) for point in line.get("points").split()):
            assert svg_drawing.LEFT - 0.1 <= x <= 640 - svg_drawing.RIGHT + 0.1
            assert svg_drawing.TOP - 0.1 <= y <= 250


def test_places_are_done_in_the_plans_own_order():
    plan = plan_from(
        {"cycles": 2, "order": "rounds", "places": {"kind": "listed", "at_mm": [[0, 0], [9, 0]]}}
    )
    a_press = len(plan.shots(next(plan.presses())))
    assert status_text.done_by_place(plan, 0) == {"l0": 0.0, "l1": 0.0}
    assert status_text.done_by_place(plan, a_press) == {"l0": 0.5, "l1": 0.0}
    assert status_text.done_by_place(plan, 2 * a_press - 1) == {"l0": 0.5, "l1": 0.0}
    assert status_text.done_by_place(plan, 4 * a_press) == {"l0": 1.0, "l1": 1.0}


def test_nothing_on_the_page_comes_from_elsewhere():
    own = "http://${location.hostname}:${listener.port}/"
    for text in (page_shell.style(), page_shell.text_of("estop.html").replace(own, "")):
        assert not re.search(r"https?:|//[a-z]|@import|url\(", text)


def test_the_page_stops_over_the_path_and_with_the_header_that_are_answered():
    pytest.importorskip("fastapi", reason="NiceGUI is not installed")
    from palpate.studio import page_security, page_server

    html = page_server.estop_html(8081, "x")
    assert f'"path": "{page_security.ESTOP_PATH}"' in html
    assert f'"{page_server.HEADER}": "estop"' in html
    for what in re.findall(r'(?:stop|ask)\("([a-z-]+)"\)', page_shell.text_of("estop.html")):
        assert what in page_server.STOP_REQUESTS

import dataclasses
import math
from dataclasses import replace

import numpy as np
import pytest
from tests.refusals import refused

from palpate.core import InputError, Probe, RangeError
from palpate.sensors import palm
from palpate.sensors.palm import View, fringe_view
from palpate.sensors.palm.palm_spec import scaled_down


def test_the_palm_is_the_reports_where_the_report_speaks():
    spec = palm.palm()
    assert (spec.diameter_m, spec.indenter_radius_m) == (57e-3, 5e-3)
    assert spec.frame_px == (1920, 1080)
    assert spec.fringes.box_px == (380, 60, 1420, 420)
    assert spec.mirror.box_px == (700, 560, 700, 420)


@pytest.mark.parametrize("make", [palm.debug, palm.crops])
def test_fewer_pixels_show_the_same_part_of_the_membrane(make):
    for full, fewer in (
        (palm.palm().fringes, make().fringes),
        (palm.palm().mirror, make().mirror),
    ):
        for part in ("x_m", "down_m"):
            seen, shown = getattr(full, part), getattr(fewer, part)
            pixel = shown[1] - shown[0]
            # from edge to edge; whole pixels are all that is lost
            edges = seen[0] - (seen[1] - seen[0]) / 2, seen[-1] + (seen[1] - seen[0]) / 2
            assert shown[0] - pixel / 2 == pytest.approx(edges[0], abs=pixel)
            assert shown[-1] + pixel / 2 == pytest.approx(edges[1], abs=pixel)


def test_a_smaller_picture_is_the_mean_of_the_larger():
    large = replace(palm.debug(), rays_per_pixel=(1, 1))
    light = [
        fringe_view.march_fringes(spec, 3e-3, 4e-3, -3e-3) for spec in (large, scaled_down(large, 2, "half"))
    ]
    h, w, _ = light[1].shape
    np.testing.assert_allclose(
        light[0].reshape(h, 2, w, 2, 3).mean(axis=(1, 3)), light[1], atol=1e-5
    )  # float32


def test_every_preset_goes_by_its_name():
    for name in palm.PRESETS:
        assert palm.preset(name) == palm.PRESETS[name]()
    with pytest.raises(InputError, match=r"'gelsight'.*sylgard-184.*casting-resin"):
        palm.preset("gelsight")


@pytest.mark.parametrize(
    ("part", "value", "code"),
    [
        ("youngs_modulus_pa", 0.0, "spec-range"),
        ("youngs_modulus_pa", math.nan, "spec-range"),
        ("poisson_ratio", 0.5, "poisson-ratio"),
        ("thickness_m", 0.0, "spec-range"),
        ("refractive_index", 0.9, "spec-range"),
        ("extinction", 1.5, "spec-range"),
        ("polariser_rad", math.nan, "spec-range"),
        ("lamp_mired", 201.0, "spec-range"),
        ("ambient", math.nan, "spec-range"),
        ("bands", 3, "spec-range"),
        ("rays_per_pixel", (0, 1), "ray-count"),
    ],
)
def test_a_palm_that_cannot_be_is_refused_with_what_can(part, value, code):
    with refused(code, RangeError):
        replace(palm.palm(), **{part: value})


def test_a_region_outside_the_frame_is_refused():
    with refused("view-outside-frame", InputError):
        replace(palm.palm(), fringes=View((1900, 60, 100, 420), 44e-6, (50.0, 110.0)))
    with refused("pixel-size", RangeError):
        replace(palm.palm(), mirror=View((700, 560, 700, 420), 0.0, (350.0, 210.0)))


@pytest.mark.parametrize(
    ("words", "probe"),
    [
        ("sphere:10", Probe("sphere", 5e-3)),
        ("punch:6", Probe("punch", 3e-3)),
        ("flat:6", Probe("punch", 3e-3)),
        ("edge:12:30", Probe("edge", 0.0, 12e-3, math.radians(30))),
        ("cylinder:6:12", Probe("cylinder", 3e-3, 12e-3)),
        ("two-points:4:8:90", Probe("two-points", 2e-3, 8e-3, math.radians(90))),
    ],
)
def test_words_in_millimetres_and_degrees_are_a_probe(words, probe):
    read = dataclasses.astuple(palm.parse_probe(words))
    assert read[0] == probe.shape
    assert read[1:5] == pytest.approx(dataclasses.astuple(probe)[1:5], abs=1e-15)
    assert read[5] == ()


@pytest.mark.parametrize("words", ["sphere:0", "punch:inf", "cylinder:6:12:nan"])
def test_a_probe_without_a_size_is_refused(words):
    with refused("not-positive", InputError):
        palm.parse_probe(words)

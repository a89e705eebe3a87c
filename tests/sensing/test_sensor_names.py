"""A calibration of one sensor is not read on another by the size of its frames alone."""

from __future__ import annotations

import numpy as np
import pytest
from tests.refusals import refused

from palpate.core import InputError
from palpate.recordings import Manifest, RunWriter
from palpate.sensing.live_sources import open_live_source
from palpate.sensing.streaming.live_slots import refuse_other_sensor, sensor_family, stated_sensor


def run_of(folder, sensor: str):
    """A run of two bare frames, as large as those that `calibrate_spots` learns from."""
    with RunWriter.create(
        folder / sensor.replace(" ", "-"), Manifest.new(sensor=sensor, labels={})
    ) as writer:
        for _ in range(2):
            writer.frame(np.zeros((48, 64), np.uint8))
    return folder / sensor.replace(" ", "-")


@pytest.mark.parametrize(
    ("name", "family"),
    [
        ("palm-rig", "palm"),
        ("virtual:palm", "palm"),
        ("virtual tactip/S1=7.6", "tactip"),
        ("gelsight-mini", "gelsight-mini"),
        ("palmistry", ""),
        ("", ""),
    ],
)
def test_a_name_means_a_kind_of_sensor_only_where_it_surely_does(name: str, family: str) -> None:
    assert sensor_family(name) == family


def test_a_run_states_its_sensor_and_is_refused_where_that_is_of_another_kind(tmp_path) -> None:
    run = run_of(tmp_path, "palm-rig")
    for source in (open_live_source(run), open_live_source(run, paced=True)):
        assert stated_sensor(source) == "palm-rig"
        for same in ("palm-rig", "palm", "virtual palm", ""):
            assert refuse_other_sensor(same, source) == ""
        assert "of palm-rig" in refuse_other_sensor("mine", source)
        with refused("sensor-differs", InputError):
            refuse_other_sensor("tactip", source)

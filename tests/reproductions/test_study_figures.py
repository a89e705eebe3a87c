"""Figures of reproduced studies: what is infinite breaks none."""

import numpy as np

from palpate_reproductions.study_figures import (
    ComparedValue,
    forest_figure,
    line_figure,
    plate_figure,
    trend_figure,
)

FORCE = np.linspace(0.5, 5, 12)
NAMES = ("S1", "new", "S2", "S3")


def test_the_reports_figures_are_pictures_that_a_page_can_hold() -> None:
    courses = {name: [(FORCE, FORCE), (FORCE, 2 * FORCE)] for name in NAMES}
    groups = {name: [1.0 + i, 1.1 + i] for i, name in enumerate(NAMES)}
    told = ComparedValue(
        "cue", {n: [1.0, 1.1] for n in ("S1", "S2", "S3")}, {"S1": 7.6, "S2": 3.1, "S3": 1.1},
        -2.0, 9.0, 1.05, (5.0, -np.inf, np.inf), 5.3,
    )  # fmt: skip
    pictures = [
        plate_figure(dict.fromkeys(NAMES, (FORCE, FORCE)), groups, dict.fromkeys(NAMES, (1.0, 0.0))),
        trend_figure({"area|rate": (courses, groups), "sum|total": (courses, groups)}),
        line_figure([told, told, told]),
        forest_figure({"touch": (5.3, 4.9, 5.6), "line": (3.0, -np.inf, np.inf)}, 5.3, {"line": 4.99}),
    ]
    for one in pictures:
        assert one.startswith("data:image/")
        assert len(one) > 5000

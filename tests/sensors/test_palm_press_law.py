"""The law that presses are rendered by is its own: no constant of a rig, a plan or the preset is in it."""

from __future__ import annotations

import ast
import math
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from palpate.core import Pose
from palpate.rig.plans.recording_plan import RecordingPlan
from palpate.rig.virtual.disturbances import Variation
from palpate.sensors import palm
from palpate.sensors.palm import palm_variation, random_presses
from palpate.sensors.palm.palm_press import depth_of_force, press
from palpate.sensors.palm.palm_variation import PRESS_LAW, PressLaw

SPEC = palm.cropped(palm.palm(), 32, "test")
THRESHOLD_N, LATE_MM = 0.05, 0.008  # at which a recording's plan calls contact, and how late the rig finds it


def numbers_of(law: PressLaw) -> Iterator[float]:
    for field in fields(law):
        value = getattr(law, field.name)
        yield from (float(one) for one in (value if isinstance(value, tuple) else (value,)))


def rig_constants() -> list[float]:
    variation, camera = Variation(), SPEC.camera
    flat = np.concatenate([np.ravel(getattr(variation, f.name)) for f in fields(variation)]).astype(float)
    own = [camera.full_well_e, camera.read_noise_e, THRESHOLD_N, LATE_MM, 1 + 0.06 + 0.05]
    return [value for value in [*flat.tolist(), *own] if value]


def has_no_rig_in(source: str) -> bool:
    """Whether nothing of the rig, nor of a recording's plan, is imported."""
    names = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom):
            names += [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
    return not any(name.startswith("palpate.rig") for name in names)


def test_no_number_of_the_law_is_the_rig_s() -> None:
    for number in numbers_of(PRESS_LAW):
        assert not any(math.isclose(number, own, rel_tol=1e-6) for own in rig_constants()), number
    assert RecordingPlan.model_fields["threshold_N"].default == THRESHOLD_N
    # A law with the rig's threshold in it is found out.
    stolen = replace(PRESS_LAW, threshold_n=(THRESHOLD_N, THRESHOLD_N))
    assert any(math.isclose(n, own) for n in numbers_of(stolen) for own in rig_constants())


def test_what_draws_presses_imports_nothing_of_a_rig() -> None:
    for module in (palm_variation, random_presses):
        assert has_no_rig_in(Path(module.__file__).read_text(encoding="utf-8"))
    assert not has_no_rig_in("from palpate.rig.virtual.disturbances import Variation")
    assert not has_no_rig_in("import palpate.rig.plans")
    drawing = Path(random_presses.__file__).read_text(encoding="utf-8").split("LOAD_DEPTH_MM")[0]
    literals = [
        node.value
        for node in ast.walk(ast.parse(drawing))
        if isinstance(node, ast.Constant) and isinstance(node.value, float)
    ]
    assert not {THRESHOLD_N, LATE_MM, Variation().lamp} & set(literals)


DRAWS = 300


def test_copies_and_views_take_all_of_every_range_and_never_the_preset_s_value() -> None:
    rng = np.random.default_rng(3)
    copies = [PRESS_LAW.copy(SPEC, rng) for _ in range(DRAWS)]
    views = [PRESS_LAW.view(SPEC, rng) for _ in range(DRAWS)]
    zeros = np.array([PRESS_LAW.zero(rng) for _ in range(DRAWS)])
    drawn = {
        "modulus": [c.youngs_modulus_pa / SPEC.youngs_modulus_pa for c in copies],
        "coefficient": [
            c.stress_optic.coefficient_per_pa / SPEC.stress_optic.coefficient_per_pa for c in copies
        ],
        "thickness": [c.thickness_m / SPEC.thickness_m for c in copies],
        "polariser_deg": [math.degrees(c.polariser_rad - SPEC.polariser_rad) for c in copies],
        "elevation_deg": [math.degrees(c.mirror_elevation_rad - SPEC.mirror_elevation_rad) for c in copies],
        "lamp": [v["lamp_gain"] for v in views],
        "full_well_e": [v["camera"].full_well_e for v in views],
        "read_noise_e": [v["camera"].read_noise_e for v in views],
        "blur_px": [v["chain"].blur_px for v in views],
        "shift_px": [v["mirror"].shift_px[1] for v in views],
        "turn_deg": [math.degrees(v["fringes"].turn_rad) for v in views],
        "residual": [v["residual"].birefringence for v in views],
        "frozen": [v["frozen_birefringence"] for v in views],
        "texture": [v["dirt"].texture for v in views],
        "glare": [v["glare"].peak for v in views],
        "ambient": [v["ambient"] for v in views],
        "stops": [v["auto_exposure"].max_stops for v in views],
        "threshold_n": zeros[:, 0],
        "late_mm": zeros[:, 1],
    }
    for name, values in drawn.items():
        low, high = getattr(PRESS_LAW, name)
        assert low <= min(values) < low + 0.1 * (high - low), name
        assert high - 0.1 * (high - low) < max(values) <= high, name
        assert len(set(values)) == DRAWS, name
    assert {v["dirt"].specks for v in views} <= set(range(26))
    assert len({v["residual"].seed for v in views}) == DRAWS
    assert 0.3 < sum(v["chain"].jpeg_quality is None for v in views) / DRAWS < 0.7


def test_a_label_is_its_own_palm_s_force_below_its_own_contact() -> None:
    """With ranges of no width each label is that of the one palm that is left."""
    point = {
        f.name: (getattr(PRESS_LAW, f.name)[0],) * 2
        for f in fields(PRESS_LAW)
        if isinstance(getattr(PRESS_LAW, f.name), tuple)
    }
    law = replace(
        PRESS_LAW, **{**point, "stiffening": (1.0, 1.0), "threshold_n": (0.2, 0.2), "late_mm": (0.03, 0.03)}
    )
    drawn = random_presses.draw_presses(SPEC, 2, 2, np.random.default_rng(1), law=law)
    skin = law.copy(SPEC, np.random.default_rng(0))
    assert skin.youngs_modulus_pa == pytest.approx(0.55 * SPEC.youngs_modulus_pa)
    zero_mm = 1e3 * depth_of_force(skin, 0.2) + 0.03
    for depth_mm, x_mm, y_mm, force_n in drawn.values.astype(float):
        pose = Pose(1e-3 * x_mm, 1e-3 * y_mm, 1e-3 * (depth_mm + zero_mm))
        assert press(skin, pose).force_n == pytest.approx(force_n, rel=1e-4)

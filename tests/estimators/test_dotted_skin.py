"""Dots of rendered skins against where they truly are, and descriptions of skins."""

import json
from pathlib import Path

import numpy as np
import pytest
from tests.rendered_boards import View, dots, noisy

from palpate.core import ImageError, InputError, RangeError
from palpate.estimators.lattice import DottedSkin, find_dots, read_skin

LOST = frozenset({(1, 1), (2, 1), (-3, 2)})


@pytest.mark.parametrize(("kind", "colour"), [("square", "dark"), ("hexagonal", "bright")])
def test_dots_lie_where_they_are_within_their_stated_error(kind, colour) -> None:
    view = View(turn=0.1, shear=0.05, pitch=34, hexagonal=kind == "hexagonal", size=(480, 360))
    picture = noisy(dots(view, dark=colour == "dark", lost=LOST, extent=(12, 10)), np.random.default_rng(0))
    points = find_dots(picture, DottedSkin(kind, 34, 6.8, colour))
    true = np.rint(view.lattice(points.places)).astype(int)
    assert len(np.unique(true - points.cells, axis=0)) == 1
    assert not set(map(tuple, true.tolist())) & LOST
    off = points.places - view.places(true.astype(float))
    assert len(points) > 60
    assert np.sqrt((off**2).mean()) < 0.05
    assert 0.75 < (off / points.sigma[:, None]).std() < 1.25


def test_dots_of_a_strong_fisheye_are_named_on_the_straightened_image() -> None:
    """Dots 16 px apart at the rim and 40 in the middle: an equidistant lens, in closed form."""
    focal, middle = 100.0, np.array([160.0, 120.0])
    i, j = np.meshgrid(np.arange(-4, 5), np.arange(-3, 4))
    flat = 40.0 * np.stack([i, j], axis=-1).reshape(-1, 2)
    r = np.maximum(np.hypot(*flat.T), 1e-9)
    true = middle + flat * (focal * np.arctan(r / focal) / r)[:, None]
    x, y = np.meshgrid(np.arange(320), np.arange(240))
    image = np.full((240, 320), 150.0)
    for at in true:
        image -= 110 * np.clip(3.7 - np.hypot(x - at[0], y - at[1]), 0, 1)
    skin = DottedSkin("square", 40, 3.5, fisheye=(160, 120, focal))
    points = find_dots(noisy(image, np.random.default_rng(1)), skin)
    cells = np.stack([i, j], axis=-1).reshape(-1, 2)
    nearest = np.hypot(*(points.places[:, None] - true).transpose(2, 0, 1)).argmin(axis=1)
    assert len(points) > 0.9 * len(true)
    assert len(np.unique(cells[nearest] - points.cells, axis=0)) == 1
    assert np.abs(points.places - true[nearest]).max() < 0.1


@pytest.mark.parametrize("name", ["skin.json", "skin.toml"])
def test_a_skin_s_description_is_read_from_a_file(name, tmp_path: Path) -> None:
    text = (
        json.dumps({"kind": "hexagonal", "pitch_px": 30, "radius_px": 5, "region": [1, 2, 30, 40]})
        if name.endswith("json")
        else 'kind = "hexagonal"\npitch_px = 30\nradius_px = 5\nregion = [1, 2, 30, 40]\n'
    )
    (tmp_path / name).write_text(text)
    assert read_skin(tmp_path / name) == DottedSkin("hexagonal", 30, 5, region=(1, 2, 30, 40))


@pytest.mark.parametrize("text", ['{"pich_px": 3}', "[1]", "{", '{"pitch_px": "wide"}', '{"region": 3}'])
def test_a_description_that_is_none_is_refused(text, tmp_path: Path) -> None:
    (tmp_path / "skin.json").write_text(text)
    with pytest.raises(InputError):
        read_skin(tmp_path / "skin.json")


def test_a_frame_without_dots_and_a_skin_that_cannot_be_are_refused() -> None:
    with pytest.raises(ImageError, match="dots"):
        find_dots(noisy(np.full((240, 320), 120.0), np.random.default_rng(2)), DottedSkin())
    with pytest.raises(RangeError, match="radius"):
        DottedSkin(pitch_px=10, radius_px=8)

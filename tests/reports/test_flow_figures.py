"""The flow of a sequence on disk: what the table says is what was found; the folder is whole or not there."""

from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
import tifffile
from PIL import Image

from palpate.core.errors import ExistsError, InputError
from palpate.estimators.flow.horn_schunck import divergence, flow
from palpate.reports.field_figures import write_flow


def frames(rng, many=6) -> np.ndarray:
    """A smooth pattern that stretches faster and faster."""
    y, x = np.indices((60, 80)) - np.array([29.5, 39.5])[:, None, None]
    made = [128 + 60 * np.sin(0.35 * x * s) * np.cos(0.3 * y * s) for s in 1 - 0.002 * np.arange(many) ** 2]
    return np.rint(made + rng.normal(0, 1, (many, 60, 80))).astype(np.uint8)


@pytest.fixture
def stretch(rng, tmp_path):
    tifffile.imwrite(tmp_path / "stretch.tif", frames(rng), photometric="minisblack")
    return tmp_path / "stretch.tif"


def test_the_table_holds_the_means_of_every_step(rng, stretch, tmp_path, figures_blank) -> None:
    write_flow(stretch, tmp_path / "out", region_px=(20, 10, 40, 30))
    table = pd.read_csv(tmp_path / "out/flow.csv")
    pages = tifffile.imread(stretch)
    fields = [flow(a, b) for a, b in pairwise(pages)]
    inside = (slice(10, 40), slice(20, 60))
    spread = [divergence(field)[inside].mean(dtype=float) for field in fields]
    flux = [divergence(field).mean(dtype=float) for field in fields]
    speed = [np.hypot(*field)[inside].mean() for field in fields]
    assert table["speed_px"].to_numpy() == pytest.approx(speed, rel=1e-5)
    assert table["border_flux_per_frame"].to_numpy() == pytest.approx(flux, rel=1e-9)
    assert table["divergence_per_frame"].to_numpy() == pytest.approx(spread, rel=1e-9)
    assert table["accumulated_divergence"].to_numpy() == pytest.approx(np.cumsum(spread), rel=1e-9)


def test_the_picture_is_no_blank_sheet(stretch, tmp_path) -> None:
    write_flow(stretch, tmp_path / "out")
    picture = np.asarray(Image.open(tmp_path / "out/flow.png").convert("RGB"))
    assert picture.shape[1] > 1000
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 100


@pytest.mark.parametrize("shape", [(8, 8), (3, 200), (200, 3)])
@pytest.mark.cases(1)
def test_still_small_and_narrow_frames_are_drawn(tmp_path, shape, figures_small) -> None:
    tifffile.imwrite(tmp_path / "still.tif", np.full((3, *shape), 90, np.uint8), photometric="minisblack")
    found = write_flow(tmp_path / "still.tif", tmp_path / "out")
    assert found["mean_speed_px"] == 0
    assert (tmp_path / "out/flow.png").is_file()


def test_a_folder_is_whole_or_not_there(stretch, tmp_path, figures_blank) -> None:
    with pytest.raises(InputError, match="no method"):
        write_flow(stretch, tmp_path / "out", method="by eye")
    assert {path.name for path in tmp_path.iterdir()} == {"stretch.tif"}
    write_flow(stretch, tmp_path / "out")
    before = (tmp_path / "out/flow.csv").read_bytes()
    with pytest.raises(ExistsError, match="exists"):
        write_flow(stretch, tmp_path / "out")
    assert (tmp_path / "out/flow.csv").read_bytes() == before

"""An experiment's folder: what is written is read back, and what is missing is named."""

import math

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from tests.refusals import refused

from palpate.core.errors import ExistsError, ImageError, InputError, LabelError
from palpate.recordings.exchange.frame_sequences import TiffFrames, write_tiff
from palpate.recordings.exchange.press_folder import press_folder, write_press, write_specimens
from palpate.recordings.exchange.press_table import press_rows, read_press_table

STIFFNESS = {"soft": 1.1e3, "007": math.nan, "rigid": math.inf}


def rows(samples=40, every=10) -> pd.DataFrame:
    i = np.arange(samples)
    return press_rows(
        i / 200, 0.0625 * i, 25e-6 * i, 25e-6 * i + 12e-6, i[::every], np.where(i < 5, np.nan, 1e-6 * i)
    )


@pytest.fixture
def frames(rng):
    return rng.integers(0, 256, (4, 24, 32), dtype=np.uint8)


@pytest.fixture
def folder(tmp_path, frames):
    """Three specimens, of which none is in the order of the names."""
    write_specimens(tmp_path, STIFFNESS)
    for name in STIFFNESS:
        for press in ("02", "01"):
            write_press(tmp_path / name, press, iter(frames), rows())
    return tmp_path


def test_specimens_come_in_the_order_of_their_table_and_presses_in_that_of_their_names(folder) -> None:
    found = press_folder(folder)
    assert [one.name for one in found.specimens] == list(STIFFNESS)
    assert [one.stiffness_n_m for one in found.specimens] == [pytest.approx(1.1e3), None, math.inf]
    for one in found.specimens:
        assert [(tiff.name, table.name) for tiff, table in one.presses] == [
            ("01.tif", "01.csv"),
            ("02.tif", "02.csv"),
        ]


def test_frames_and_samples_come_back_equal(folder, frames) -> None:
    tiff, table = press_folder(folder).specimens[0].presses[0]
    with TiffFrames(tiff) as pages:
        assert_array_equal(np.stack(list(pages)), frames)
    found = read_press_table(table, 4)
    i = np.arange(40)
    assert_array_equal(found.force_n, 0.0625 * i)  # sixteenths, which nine digits hold
    assert_allclose(found.time_s, i / 200, rtol=1e-15)
    assert_allclose(found.position_m, 25e-6 * i + 12e-6, rtol=1e-9)
    assert_allclose(found.area_m2, np.where(i < 5, np.nan, 1e-6 * i), rtol=1e-9)
    assert_array_equal(found.frame_sample, i[::10])


@pytest.mark.parametrize(
    ("spoil", "kind", "said"),
    [
        (lambda p: (p / "soft" / "01.csv").unlink(), InputError, "press-incomplete"),
        (lambda p: (p / "soft" / "01.tif").unlink(), InputError, "press-incomplete"),
        (lambda p: (p / "soft" / "01.tiff").touch(), InputError, "press-ambiguous"),
        (lambda p: [f.unlink() for f in (p / "soft").iterdir()], InputError, "no-presses"),
        (lambda p: (p / "soft").rename(p / "hard"), LabelError, "specimen-folder-missing"),
        (lambda p: (p / "other").mkdir(), LabelError, "specimen-row-missing"),
    ],
)
def test_what_is_missing_is_named(folder, spoil, kind, said) -> None:
    spoil(folder)
    with refused(said, kind):
        press_folder(folder)


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (["specimen,stiffness_N_per_mm", "soft,1.1", "soft,1.1"], "row-repeated"),
        (["specimen,stiffness_N_per_mm", "soft,1", "007,0", "rigid,inf"], "stiffness"),
        (["specimen,stiffness_N_per_mm", "soft,-inf", "007,1", "rigid,inf"], "stiffness"),
        (["specimen,stiffness_N_per_mm", "soft,1", "007,2", "rigid,very"], "table-number"),
        (["specimen,stiffness", "soft,1", "007,2", "rigid,inf"], "column-missing"),
        (["name,stiffness_N_per_mm", "soft,1", "007,2", "rigid,inf"], "column-missing"),
        (["specimen,stiffness_N_per_mm", "soft,1", "../007,2", "rigid,inf"], "specimen-folder-missing"),
        ([], "table-empty"),
    ],
)
def test_a_table_of_specimens_that_cannot_be_meant_is_refused(folder, lines, said) -> None:
    (folder / "specimens.csv").write_text("\n".join(lines))
    with refused(said, LabelError):
        press_folder(folder)


def test_no_folder_and_an_empty_one_are_refused(tmp_path) -> None:
    with refused("folder-missing", InputError):
        press_folder(tmp_path / "gone")
    with refused("folder-empty", InputError):
        press_folder(tmp_path)


def test_nothing_is_overwritten_and_nothing_half_written_is_left(folder, frames) -> None:
    with pytest.raises(ExistsError):
        write_press(folder / "soft", "01", iter(frames), rows())
    with pytest.raises(ExistsError):
        write_specimens(folder, STIFFNESS)

    def stopped():
        yield frames[0]
        raise KeyboardInterrupt

    for bad, kind in (
        (stopped(), KeyboardInterrupt),
        (iter(()), ImageError),
        (iter([np.ones((3, 4, 4), np.uint8)]), ImageError),
        (iter([frames[0], frames[1][:5]]), ImageError),
    ):
        with pytest.raises(kind):
            write_tiff(folder / "soft" / "03.tif", bad)
    assert len(list((folder / "soft").iterdir())) == 4


def test_names_and_stiffnesses_that_cannot_be_written_are_refused(tmp_path) -> None:
    for name in ("../up", "", ".hidden", "a/b", "=1+1"):
        with refused("folder-name", InputError):
            write_specimens(tmp_path, {name: 1.0})
    with pytest.raises(InputError, match="above 0"):
        write_specimens(tmp_path, {"S1": 0.0})
    with refused("frame-order", LabelError):
        press_rows(*[np.arange(4.0)] * 4, np.array([1, 3]))
    assert not list(tmp_path.iterdir())

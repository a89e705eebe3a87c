"""Every parser of the package refuses damage by an error of palpate's own tree, whatever the bytes."""

import ast
import os
import random
import re
import signal
import zipfile
from pathlib import Path

import numpy as np
import pytest
from jaxtyping import TypeCheckError
from tests import parser_feeds as feeds
from tests.laws.sources import containing

from palpate.core import InputError, PalpateError, StorageError
from palpate.core.array_files import read_arrays
from palpate.core.parsing import PARSERS, damage_refused, parser

INPUTS = 25  # of each kind for each parser; `tools/fuzz_parsers.py` feeds as many as it has time for
LIMIT_S = 20.0  # for one input, on a machine that does other work as well

RAW = {
    "csv.reader", "csv.DictReader", "cv2.imread", "cv2.imdecode", "cv2.VideoCapture", "json.load",
    "json.loads", "np.load", "np.fromfile", "np.loadtxt", "np.genfromtxt", "onnx.load", "pd.read_csv",
    "pd.read_parquet", "tifffile.TiffFile", "tomllib.loads", "tomllib.load", "zipfile.ZipFile",
    "pa.parquet.ParquetFile",
}  # fmt: skip
"""Calls that decode what may have come from a file."""

OTHERS = {
    "calibration/fitting.py": "its own checkpoints, in a folder that it made",
    "calibration/lens/boards.py": "OpenCV gives None for damage, which is refused",
    "calibration/robustness/perturbation_suite.py": "a model that the estimator has admitted",
    "calibration/robustness/perturbations.py": "images that it has just encoded",
    "calibration/shear/shear_calibration.py": "a field of a calibration record",
    "cli/stop_command.py": "a rig's file, for its port; the command tree reports damage",
    "cli/verb_support.py": "words of the command line",
    "devices/rpc.py": "messages between processes, refused by `decode_message`",
    "estimators/networks/augmentation.py": "images that it has just encoded",
    "mechanics/axisymmetric/tip_table.py": "a table of the package",
    "mechanics/axisymmetric/pulled_sphere.py": "a table of the package",
    "mechanics/axisymmetric/shape_table.py": "a table of the package",
    "optics/image_chain.py": "images that it has just encoded",
    "recordings/exchange/press_export.py": "events of a run, whose reader has checked them",
    "recordings/segments/segment_writer.py": "messages of a run, read by `read_chunk`",
    "reports/sections/certificate_sections.py": "files of a calibration whose hashes are checked",
    "rig/real/position_evidence.py": "its own record; a damaged one counts as none",
    "rig/real/uvc_camera.py": "a camera",
    "rig/run_progress.py": "events of a run, whose reader has checked them",
    "sensing/live_service.py": "words of its own starter",
    "studio/library/background_jobs.py": "lines of its own process",
    "studio/live/start_desk.py": "lines of its own process",
    "studio/live/start_process.py": "lines of its own process",
    "estimators/unit_fit.py": "units, for the parsers of each sensor's",
    "studio/stop_listener.py": "answers of its own process",
    "studio/stop_process.py": "requests and address files; it imports only the standard library",
    "version.py": "text that has been refused already",
    "workflows/start_session.py": "text that it has just made",
}
"""Modules without a parser of their own that decode, and what they decode."""


@pytest.fixture(scope="module", autouse=True)
def _registered() -> None:
    feeds.load_every_parser()


def called(call: ast.Call) -> str:
    return ast.unparse(call.func)


def test_every_module_that_decodes_has_a_parser_or_decodes_what_is_its_own() -> None:
    marked = {entry.path.partition(":")[0] for entry in PARSERS.values()}
    decoding = set()
    for name, tree in containing("|".join(rf"\b{re.escape(call)}\b" for call in RAW)):
        if any(isinstance(one, ast.Call) and called(one) in RAW for one in ast.walk(tree)):
            module = "palpate." + name.removesuffix(".py").replace("/", ".")
            if module not in marked and not name.startswith("core/"):
                decoding.add(name)
    # a law that saw nothing would hold as well
    assert decoding <= set(OTHERS), sorted(decoding - set(OTHERS))
    assert {"rig/run_progress.py", "devices/rpc.py"} <= decoding


def test_every_parser_is_fed() -> None:
    assert {name for name, one in PARSERS.items() if ".networks." not in one.path} == (
        set(feeds.FEEDS) | feeds.OWN_TABLES
    )


@pytest.mark.parametrize("name", sorted(set(feeds.FEEDS) - feeds.NEARLY))
def test_the_valid_file_of_each_parser_is_read(name: str, tmp_path) -> None:
    feeds.FEEDS[name].seed(tmp_path)
    feeds.FEEDS[name].read(tmp_path)


class LateError(BaseException):
    """An input took too long."""


def fed(name: str, folder: Path, content: bytes) -> str:
    """The code with which bytes are refused; empty where they are read."""
    feed = feeds.FEEDS[name]
    (folder / feed.target).write_bytes(content)
    if name in ("calibration", "novelty guard"):
        feeds.resealed(folder, feed.target)

    def late(*_: object) -> None:
        raise LateError

    before = signal.signal(signal.SIGALRM, late)
    signal.setitimer(signal.ITIMER_REAL, LIMIT_S)
    try:
        feed.read(folder)
    except PalpateError as e:
        return e.code
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
    return ""


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", sorted(feeds.FEEDS))
def test_damage_is_refused_by_an_error_of_the_tree_with_a_code(name: str, tmp_path) -> None:
    feed, rng = feeds.FEEDS[name], random.Random(name)
    feed.seed(tmp_path)
    valid = (tmp_path / feed.target).read_bytes()
    codes = [fed(name, tmp_path, feeds.random_bytes(rng)) for _ in range(INPUTS)]
    codes += [fed(name, tmp_path, feeds.damaged(valid, rng)) for _ in range(INPUTS)]
    assert len(codes) == 2 * INPUTS
    if name not in NEVER_REFUSE:
        assert any(codes)


NEVER_REFUSE = {"fold checkpoint", "run", "run notes", "run segment", "saliency map", "session folder"}
"""Parsers that leave damage out, and tell of it in what they return."""


def test_an_exception_of_any_kind_becomes_the_parsers_own_with_the_files_name(tmp_path) -> None:
    entry = PARSERS["lens file"]
    path = tmp_path / "file"
    kinds = (
        ValueError, KeyError, UnicodeError, OverflowError, RecursionError, MemoryError, AttributeError,
        TypeError, IndexError, EOFError, zipfile.BadZipFile, RuntimeError, ZeroDivisionError,
    )  # fmt: skip
    for kind in kinds:
        with pytest.raises(InputError) as refused, damage_refused(entry, path):
            raise kind("inside")
        assert str(path) in str(refused.value)
        assert refused.value.code in ("file-damaged", "file-size")
        assert isinstance(refused.value.__cause__, kind)
    with pytest.raises(StorageError), damage_refused(entry, path):
        raise OSError(5, "input/output error")
    with pytest.raises(KeyboardInterrupt), damage_refused(entry, path):
        raise KeyboardInterrupt


@pytest.mark.parametrize("name", ["lens file", "image", "table of labels", "novelty guard", "TIFF", "video"])
def test_a_pipe_is_refused_before_it_is_read(name: str, tmp_path) -> None:
    feed = feeds.FEEDS[name]
    feed.seed(tmp_path)
    (tmp_path / feed.target).unlink()
    os.mkfifo(tmp_path / feed.target)
    with pytest.raises(PalpateError) as refused:
        feed.read(tmp_path)
    assert refused.value.code == "file-kind"


def test_a_file_beyond_the_limit_is_refused_before_it_is_read(tmp_path) -> None:
    path = tmp_path / "lens.json"
    with path.open("wb") as file:
        file.truncate(PARSERS["lens file"].max_bytes + 1)
    with pytest.raises(InputError) as refused:
        feeds.FEEDS["lens file"].read(tmp_path)
    assert refused.value.code == "file-size"


def test_two_parsers_of_one_name_are_refused() -> None:
    with pytest.raises(ValueError, match="lens file"):
        parser("lens file", InputError)(lambda path: path)


@pytest.mark.parametrize("order", ["C", "F"])
def test_arrays_are_read_as_numpy_reads_them(order: str, tmp_path) -> None:
    arrays = {
        "a": np.asarray(np.arange(12.0).reshape(3, 4), order=order),
        "empty": np.empty((0, 3)),
        "one": np.array(7),
        "text": np.array(["x", "yz"]),
    }
    np.savez_compressed(tmp_path / "a.npz", **arrays)
    read = read_arrays(tmp_path / "a.npz")
    assert set(read) == set(arrays)
    for name, array in arrays.items():
        np.testing.assert_array_equal(read[name], array)
        assert read[name].dtype == array.dtype
        assert read[name].flags.writeable


def test_an_archive_that_unpacks_to_more_is_refused(tmp_path) -> None:
    np.savez_compressed(tmp_path / "a.npz", a=np.zeros(1000))
    with pytest.raises(InputError) as refused:
        read_arrays(tmp_path / "a.npz", max_bytes=4000)
    assert refused.value.code == "file-size"


def test_a_violated_annotation_is_not_reported_as_damage() -> None:
    with pytest.raises(TypeCheckError), damage_refused(next(iter(PARSERS.values())), "file"):
        raise TypeCheckError("a shape")

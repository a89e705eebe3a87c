"""Shapes are checked in tests and only there; fixtures that every room's tests share."""

from __future__ import annotations

import contextlib
import ctypes
import dataclasses
import functools
import gc
import inspect
import os
import pickle
import shutil
import signal
import sys
import types
import typing
from collections.abc import Iterator
from pathlib import Path

import beartype
import hypothesis
import jaxtyping
import numpy as np
import pytest

# A background job starts with Ctrl-C ignored, and so would every process that a test starts and interrupts.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def _has_array(hint: object) -> bool:
    if isinstance(hint, list):  # a callable's arguments
        return any(map(_has_array, hint))
    is_array = isinstance(hint, type) and issubclass(hint, jaxtyping.AbstractArray)
    return is_array or any(map(_has_array, typing.get_args(hint)))


def _hints(function) -> dict[str, object]:
    """The annotations' values; anything where one has none yet, as a name that a module only declares."""
    names, hints = getattr(function, "__globals__", {}), {}
    for name, hint in getattr(function, "__annotations__", {}).items():
        try:
            hints[name] = eval(hint, names) if isinstance(hint, str) else hint
        except Exception:
            hints[name] = jaxtyping.Shaped[np.ndarray, "..."] if "array" in hint else typing.Any
    return hints


def _classes(hint: object) -> tuple[type, ...]:
    """Classes of which a value of this kind is; none where that is not told by a class."""
    if hint is None:
        return (type(None),)
    origin = typing.get_origin(hint)
    if origin in (typing.Union, types.UnionType):
        parts = [_classes(one) for one in typing.get_args(hint)]
        return sum(parts, ()) if all(parts) else ()
    found = hint if origin is None else origin
    told = isinstance(found, type) and found.__module__ != "typing" and not typing.is_typeddict(found)
    if not told or getattr(found, "_is_protocol", False):
        return ()
    return (float, int) if found is float else (found,)  # as static checkers take an int for a float


# The numeric tower lets an int stand where a float is asked for, as static checkers do.
typed = beartype.beartype(
    conf=beartype.BeartypeConf(is_pep484_tower=True, violation_type=jaxtyping.TypeCheckError)
)
jaxtyped = jaxtyping.jaxtyped

CHECKED_CALLS = 10
"""Calls of a function whose shapes and types are checked in each test: those of a loop after them would
tell nothing new, and took a third of a calibration's time and a quarter of a rig's."""
tests_begun = [0]
UNCHECKED_CALLS = 100
"""Calls after which the function itself stands in its place for the rest of a test: in a rig's tests,
which make some 400 000 of them each, the calls through this file took a tenth of the time."""
laid_bare: list[tuple[object, str, object, object]] = []


def lay_bare(call, function) -> None:
    """Put a function in the place of the one that checks it, where that stands under its own name."""
    owner = sys.modules.get(function.__module__)
    *path, name = function.__qualname__.split(".")
    for part in path:
        owner = getattr(owner, part, None)
    held = vars(owner).get(name) if owner is not None else None
    bare = function
    if isinstance(held, property) and held.fget is call:
        bare = property(function, held.fset, held.fdel, held.__doc__)
    elif held is not call:
        return
    setattr(owner, name, bare)
    laid_bare.append((owner, name, bare, held))


def begins_checked(function):
    """The function with its annotations checked at the first calls in each test.

    Its checks are written at its first call of all: most functions are called in few of the processes
    that import them, and to write the checks of all took longer than to import them.
    """
    test = calls = 0
    with_checks = None

    @functools.wraps(function)
    def call(*args, **kwargs):
        nonlocal test, calls, with_checks
        if test != tests_begun[0]:
            test, calls = tests_begun[0], 0
        calls += 1
        if calls > CHECKED_CALLS:
            if calls == UNCHECKED_CALLS:
                lay_bare(call, function)
            return function(*args, **kwargs)
        if with_checks is None:
            with_checks = checks_of(function)
        return with_checks(*args, **kwargs)

    return call


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Mark the cases of a test beyond those it asks for as slow."""
    tests = {}
    for item in items:
        if item.get_closest_marker("cases") and not item.get_closest_marker("slow"):
            tests.setdefault(item.nodeid.partition("[")[0], []).append(item)
    for cases in tests.values():
        (count,) = cases[0].get_closest_marker("cases").args
        kept = set(np.linspace(0, len(cases) - 1, count).round().astype(int)) if count > 1 else {0}
        for i, item in enumerate(cases):
            if i not in kept:
                item.add_marker(pytest.mark.slow)


@pytest.fixture(autouse=True, scope="session")
def priority_kept():
    """Keep the priority of the process: a stop raises it, which the later tests would inherit."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "setpriority", lambda *_: None, raising=False)
        yield


@pytest.fixture(autouse=True)
def shapes_checked_anew() -> None:
    """Count calls anew, so that each test checks shapes and types."""
    tests_begun[0] += 1
    while laid_bare:
        owner, name, bare, held = laid_bare.pop()
        if vars(owner).get(name) is bare:  # and nothing of a test that replaced it
            setattr(owner, name, held)


def checks_of(function):
    """The function with shapes checked where there are any, and classes everywhere.

    Beartype writes a checker for each function, of which a run calls thousands; where no shape is asked for
    it takes a twentieth of the time to look at the classes alone.
    """
    hints = _hints(function)
    if inspect.isgeneratorfunction(function) or any(map(_has_array, hints.values())):
        return jaxtyped(function, typechecker=typed)
    kinds = {name: kinds for name, hint in hints.items() if (kinds := _classes(hint))}
    made = () if inspect.iscoroutinefunction(function) else kinds.get("return", ())
    code = function.__code__
    order = code.co_varnames[: code.co_argcount]
    named = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]

    def check(name, value, classes):
        if classes and not isinstance(value, classes):
            raise jaxtyping.TypeCheckError(f"{name} of {function.__qualname__} is {value!r}, no {classes}")
        return value

    @functools.wraps(function)
    def call(*args, **kwargs):
        for name, value in zip(order, args, strict=False):
            check(name, value, kinds.get(name))
        for name in named:
            if name in kwargs:
                check(name, kwargs[name], kinds.get(name))
        return check("result", function(*args, **kwargs), made)

    return call


def checked(what):
    """What jaxtyping's hook decorates, with its annotations checked."""
    if isinstance(what, (classmethod, staticmethod)):
        return type(what)(checked(what.__func__))
    if isinstance(what, property):
        return property(*(f and checked(f) for f in (what.fget, what.fset, what.fdel)), what.__doc__)
    if inspect.isclass(what):
        if dataclasses.is_dataclass(what) and "__init__" in vars(what):
            what.__init__ = checked(what.__init__)
        return what
    return begins_checked(what) if inspect.isfunction(what) else checks_of(what)


# Before any test imports palpate: what was imported earlier would go unchecked.
jaxtyping.jaxtyped = lambda typechecker: checked
jaxtyping.install_import_hook(["palpate", "palpate_reproductions"], None)

# No deadline: how long one example takes says more about the machine's other work than about palpate.
hypothesis.settings.register_profile("palpate", deadline=None)
hypothesis.settings.load_profile("palpate")


def pytest_collection_finish() -> None:
    """Leave what was imported out of every search for garbage: it is most of what there is, and stays."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 50)


MAX_RESIDENT_MB = 1000.0
GROWN_MB = 250.0  # since the last time: to search for garbage takes a second
resident_then_mb = [0.0]


@pytest.fixture(autouse=True, scope="module")
def memory_returned() -> Iterator[None]:
    """After a module, let a large process drop tables that palpate keeps, and return its free memory."""
    yield
    if sys.platform != "linux" or resident_mb() < max(MAX_RESIDENT_MB, resident_then_mb[0] + GROWN_MB):
        return
    for name, module in list(sys.modules.items()):
        if name.partition(".")[0] in ("palpate", "palpate_reproductions"):
            for value in list(vars(module).values()):
                if isinstance(value, functools._lru_cache_wrapper):
                    value.cache_clear()
    gc.collect()
    with contextlib.suppress(OSError, AttributeError):  # another C library
        ctypes.CDLL("libc.so.6").malloc_trim(0)
    resident_then_mb[0] = resident_mb()


def resident_mb() -> float:
    pages = Path("/proc/self/statm").read_text(encoding="ascii").split()[1]
    return int(pages) * os.sysconf("SC_PAGE_SIZE") / 2**20


REPOSITORY = Path(__file__).resolve().parent.parent


@pytest.fixture(autouse=True, scope="session")
def own_state_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep the positions of stages that tests store out of the user's own folder."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        yield


@pytest.fixture(autouse=True, scope="session")
def checked_types_pass_parsers() -> Iterator[None]:
    """Let a violated annotation within a parser fail a test, not become damage of a file."""
    from palpate.core import parsing

    damaged = parsing._damaged

    def damaged_file(entry, source, cause):
        if isinstance(cause, jaxtyping.TypeCheckError):
            raise cause
        return damaged(entry, source, cause)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(parsing, "_damaged", damaged_file)
        yield


@pytest.fixture
def rng() -> np.random.Generator:
    """The same random numbers at every run."""
    return np.random.default_rng(20240607)


@pytest.fixture(scope="module")
def changes_untried():
    """Calibrations as on recordings too short to try changes of the camera on: that takes nearly half of a
    small calibration's time. For modules whose laws are of other parts of a calibration."""
    from palpate.calibration.robustness import perturbation_suite

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(perturbation_suite, "MIN_ROWS", 1_000_000)
        yield


@pytest.fixture(scope="session")
def drawn_panels() -> dict[bytes, object]:
    """Panels of certificates by what they show; see `figures_drawn_once`."""
    return {}


@pytest.fixture
def figures_drawn_once(drawn_panels, monkeypatch) -> None:
    """Each panel of a certificate is drawn once for all tests that use this: pages of one calibration differ
    in few of their figures, and matplotlib takes nearly all of a page's time. Not for tests of figures."""
    from palpate.reports import calibration_figures

    draw_panel = calibration_figures._panel

    def panel(*asked):
        key = pickle.dumps(asked)
        if key not in drawn_panels:
            drawn_panels[key] = draw_panel(*asked)
        return drawn_panels[key]

    monkeypatch.setattr(calibration_figures, "_panel", panel)


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The folder of real recordings, which is not part of the repository."""
    named = os.environ.get("PALPATE_REAL_DATA")
    folder = Path(named) if named else REPOSITORY.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"no real recordings at {folder}; name their folder in PALPATE_REAL_DATA")
    return folder


def spots(n: int, rng: np.random.Generator, lamp: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A bright spot on a patterned ground: images ``[n 48 64]``, its place [mm] and its height [mm]."""
    rows, columns = np.mgrid[0:48, 0:64]
    ground = 40 + 20 * np.cos(rows / 5) * np.cos(columns / 7) + lamp
    place, height = rng.uniform(-2, 2, n), rng.uniform(0.5, 2.0, n)
    spot = np.exp(-((columns - 32 - 8 * place[:, None, None]) ** 2 + (rows - 24) ** 2) / 30)
    noisy = ground + 70 * height[:, None, None] * spot + rng.normal(0, 1.5, (n, 48, 64))
    return np.clip(noisy, 0, 255).astype(np.uint8), place, height


@pytest.fixture
def record_spots(tmp_path):
    """Record spots as a run: five frames a press, and a no-contact frame before each press."""
    return recorder_of_spots(tmp_path)


@pytest.fixture(scope="module")
def record_spots_module(tmp_path_factory):
    """The same for a module's own fixtures."""
    return recorder_of_spots(tmp_path_factory.mktemp("spots"))


def recorder_of_spots(folder: Path):
    """A function that records spots into this folder, by the run's name."""
    from palpate.core import ManualClock
    from palpate.recordings import Manifest, Run, RunWriter

    labels = {
        "press": "text",
        "x_mm": "number",
        "height_mm": "number",
        "flat_mm": "number",
        "reference": "flag",
    }

    def record(name: str, presses: int, *, seed: int = 0, lamp: float = 0.0, colour: bool = False) -> Run:
        rng, clock = np.random.default_rng(seed), ManualClock()
        rows, columns = np.mgrid[0:48, 0:64]
        ground = 40 + 20 * np.cos(rows / 5) * np.cos(columns / 7) + lamp
        with RunWriter.create(
            folder / name, Manifest.new(sensor="spots", labels=labels), clock=clock, overflow="wait"
        ) as writer:
            for press in range(presses):
                images, place, height = spots(5, rng, lamp)
                empty = np.clip(ground + rng.normal(0, 1.5, ground.shape), 0, 255).astype(np.uint8)
                for i, image in enumerate([empty, *images]):
                    clock.sleep(0.1)
                    shown = np.repeat(image[..., None], 3, axis=2) if colour else image
                    held = {
                        "press": f"press-{press:03d}",
                        "x_mm": 0.0 if i == 0 else float(place[i - 1]),
                        "height_mm": 0.0 if i == 0 else float(height[i - 1]),
                        "flat_mm": 1.0,
                        "reference": i == 0,
                    }
                    writer.frame(shown, labels=held)
        return Run.open(folder / name)

    return record


@pytest.fixture(scope="session")
def calibrate_spots(tmp_path_factory):
    """Calibrate recorded spots, each plan once; what is given is a copy, to be changed at will."""
    from palpate.calibration import CalibrationPlan, calibrate
    from palpate.calibration.robustness import perturbation_suite

    folder = tmp_path_factory.mktemp("calibrated")
    record, runs, made = recorder_of_spots(folder), {}, {}

    def give(out: Path, presses: int = 16, run_seed: int = 0, colour: bool = False, **plan):
        shown = (presses, run_seed, colour)
        if shown not in runs:
            runs[shown] = record("-".join(map(str, ("run", *shown))), presses, seed=run_seed, colour=colour)
        asked = (*shown, perturbation_suite.MIN_ROWS, repr(sorted(plan.items())))
        if asked not in made:
            made[asked] = calibrate(runs[shown], CalibrationPlan(**plan), folder / f"calibration-{len(made)}")
        return runs[shown], Path(shutil.copytree(made[asked], out))

    return give


@pytest.fixture
def rewritten():
    """Write the frames of a run as a recording of its own, with other labels or images."""
    from palpate.recordings import Run, RunWriter

    def rewrite(run: Run, out: Path, change=lambda row: row, image=lambda image: image) -> Run:
        table = [change(dict(row)) for row in run.labels.to_dict("records")]
        known = run.manifest.labels
        kinds = {
            name: known.get(name, "number" if isinstance(value, float) else "text")
            for name, value in table[0].items()
        }
        about = run.manifest.model_copy(update={"run_id": f"of {out.name}", "labels": kinds})
        with RunWriter.create(out, about, overflow="wait") as writer:
            for i, row in enumerate(table):
                writer.frame(image(run.frame(i).image), labels=row)
        return Run.open(out)

    return rewrite

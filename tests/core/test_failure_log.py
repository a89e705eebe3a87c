"""Exceptions that nothing handled: one line with a code for the user, the traceback in a log."""

from __future__ import annotations

import json
import logging
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from palpate.core import failure_log
from palpate.core.errors import DeviceError
from palpate.core.failure_log import (
    INTERNAL,
    INTERNAL_STATUS,
    Failure,
    contained,
    log_in_workspace,
    recent_failures,
    record_failure,
    state_folder,
    thread_failures,
)


@pytest.fixture(autouse=True)
def _own_state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setattr(failure_log, "_workspace", [])


def raised(error: Exception) -> Exception:
    """The same exception with a traceback."""
    try:
        raise error  # noqa: TRY301 - what is tested needs a traceback
    except Exception as e:
        return e


def test_the_line_names_code_and_log_and_the_log_holds_the_traceback() -> None:
    failure = record_failure(raised(KeyError("a\nb")), "a test")
    assert failure.code == INTERNAL
    assert failure.log == state_folder() / failure_log.FILE
    assert "\n" not in failure.text
    assert str(failure.log) in failure.text
    assert "in raised" in failure.log.read_text()
    assert recent_failures.newest is failure


def test_an_error_of_the_tree_keeps_its_code() -> None:
    assert record_failure(raised(DeviceError("gone", code="stage-gone")), "a test").code == "stage-gone"


def test_an_exception_that_two_handlers_receive_is_written_once() -> None:
    error = raised(ValueError("twice"))
    assert record_failure(error, "one") is record_failure(error, "two")
    assert (state_folder() / failure_log.FILE).read_text().count("ValueError: twice") == 1


def test_a_workspace_has_its_own_log(tmp_path: Path) -> None:
    log_in_workspace(tmp_path / "work")
    failure = record_failure(raised(ValueError("here")), "a test")
    assert failure.log == tmp_path / "work" / ".palpate" / failure_log.FILE


def test_a_folder_that_cannot_be_written_to_is_passed_over(tmp_path: Path, monkeypatch) -> None:
    (tmp_path / "file").write_text("")
    log_in_workspace(tmp_path / "file")
    assert record_failure(raised(ValueError("one")), "a test").log == state_folder() / failure_log.FILE
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "file"))
    monkeypatch.setattr(failure_log.tempfile, "gettempdir", lambda: str(tmp_path / "file"))
    failure = record_failure(raised(ValueError("two")), "a test")
    assert failure.log is None
    assert INTERNAL in failure.text


def test_the_log_is_begun_anew_when_it_is_full(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(failure_log, "MAX_BYTES", 2000)
    for number in range(50):
        record_failure(raised(ValueError(f"number {number}")), "a test")
    sizes = {path.name: path.stat().st_size for path in state_folder().iterdir()}
    assert sizes.keys() == {"errors.log", "errors.log.1"}
    assert max(sizes.values()) < 4000


def test_a_thread_that_fails_is_logged_and_reported(capsys: pytest.CaptureFixture[str]) -> None:
    found: list[Failure] = []
    with thread_failures(found.append):
        thread = threading.Thread(target=lambda: 1 // 0, name="divides")
        thread.start()
        thread.join()
    assert [(one.code, one.where) for one in found] == [(INTERNAL, "divides")]
    assert "Traceback" not in capsys.readouterr().err


def test_a_process_that_fails_ends_with_its_own_status() -> None:
    found: list[Failure] = []
    with pytest.raises(SystemExit) as ended, contained("a test", found.append):
        raise ValueError("inside")
    assert ended.value.code == INTERNAL_STATUS
    assert [one.where for one in found] == ["a test"]
    for error in (KeyboardInterrupt, SystemExit):
        with pytest.raises(error), contained("a test", found.append):
            raise error
    assert len(found) == 1


COMMAND = """
import sys
sys.argv[1:] = {words!r}
import palpate.cli.sense.preset_verbs as verbs
import palpate.cli.command_tree
def doctor(json: bool = False) -> None:
    raise {error}
verbs.doctor = doctor
from palpate.cli import main
main()
"""


@pytest.mark.parametrize("error", ["ZeroDivisionError('unforeseen')", "OSError(5, 'input or output')"])
def test_no_traceback_of_a_command_reaches_a_user(error: str) -> None:
    code = COMMAND.format(words=["doctor", "--json"], error=error)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == INTERNAL_STATUS
    assert len(done.stderr.splitlines()) == 1
    told = json.loads(done.stdout)["error"]
    assert told["code"] == INTERNAL
    assert "in doctor" in Path(told["log"]).read_text()


INTERRUPTED = """
import sys
from palpate.cli import failures
class Interrupts:
    def find_spec(self, name, path=None, target=None):
        if name == "palpate.cli.command_tree":
            raise KeyboardInterrupt
sys.meta_path.insert(0, Interrupts())
failures.run_app()
"""


def test_ctrl_c_while_a_command_loads_ends_in_one_line_and_130() -> None:
    command = [sys.executable, "-c", INTERRUPTED]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 130
    assert len(done.stderr.splitlines()) == 1


def test_a_library_s_log_of_an_exception_is_one_line() -> None:
    pytest.importorskip("nicegui", reason="the page server needs NiceGUI")
    from palpate.studio.page_shell import FailureFilter

    record = logging.LogRecord("uvicorn.error", logging.ERROR, "f", 1, "ASGI %s", ("x",), None)
    error = raised(ValueError("in a page"))
    record.exc_info = (ValueError, error, error.__traceback__)
    assert FailureFilter().filter(record)
    assert record.exc_info is None
    assert INTERNAL in record.getMessage()
    assert recent_failures.newest is not None
    assert recent_failures.newest.message == "ValueError: in a page"

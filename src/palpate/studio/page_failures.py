"""Exceptions of the page server: one line in the terminal, the traceback in a log, a notice on every page."""

from __future__ import annotations

import logging

from nicegui import app, ui

from palpate.core.failure_log import Failure, recent_failures, record_failure

LOGGERS = ("nicegui", "uvicorn.error", "asyncio")
"""Loggers to which the page server's libraries write exceptions that nothing handled."""
LOOK_S = 1.0  # between two looks for new failures


class FailureFilter(logging.Filter):
    """Replaces the traceback of a log record by one line, and writes it to the log of failures."""

    def filter(self, record: logging.LogRecord) -> bool:
        """Rewrite a record that carries an exception; every record passes."""
        error = record.exc_info[1] if record.exc_info else None
        if isinstance(error, Exception):
            failure = record_failure(error, "the studio")
            record.msg, record.args, record.exc_info, record.exc_text = failure.text, (), None, None
        return True


def contain_failures() -> None:
    """Install the filter once, and show the code and the log on a page that cannot be built."""
    for name in LOGGERS:
        logger = logging.getLogger(name)
        if not any(isinstance(one, FailureFilter) for one in logger.filters):
            logger.addFilter(FailureFilter())
    app.on_page_exception(lambda error: ui.label(record_failure(error, "a page").text))


def notify_of_failures() -> None:
    """Notify the page that is being built of failures of the server from now on."""
    seen: list[Failure] = recent_failures.items()

    def look() -> None:
        for failure in recent_failures.items():
            if not any(failure is one for one in seen):
                ui.notify(failure.text, type="negative", timeout=0, close_button="Close")
        seen[:] = recent_failures.items()

    ui.timer(LOOK_S, look)

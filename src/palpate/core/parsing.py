"""Entry of every parser: the one place where damage to a file becomes an error of palpate's own tree."""

from __future__ import annotations

import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from palpate.core.errors import PalpateError, StorageError

P = ParamSpec("P")
R = TypeVar("R")

MAX_TEXT_BYTES = 16 << 20  # of a card, a table of settings, or a record


@dataclass(frozen=True, slots=True)
class Parser:
    """An entry of the package.

    Attributes:
        name: kind of file, as in "lens file".
        error: class of the error that damage becomes.
        max_bytes: largest file that is read.
        path: of the function, as ``module:name``.
        function: the function, without its guard.
    """

    name: str
    error: type[PalpateError]
    max_bytes: int
    path: str
    function: Callable[..., Any]


PARSERS: dict[str, Parser] = {}


def parser(
    name: str, error: type[PalpateError], *, max_bytes: int = MAX_TEXT_BYTES
) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Mark a function as the entry of a kind of file.

    Args:
        name: kind of file; each name once.
        error: class of the error that damage becomes.
        max_bytes: largest file that is read.

    Returns:
        Decorator. Of the function's arguments the first path, or text, is the file.

    Example:
        >>> from palpate.core import InputError
        >>> @parser("example file", InputError)
        ... def read_example(path: Path) -> float:
        ...     return float(path.read_text()["value"])
        >>> import tempfile
        >>> with tempfile.NamedTemporaryFile("w") as file:
        ...     try:
        ...         read_example(Path(file.name))
        ...     except InputError as e:
        ...         print(e.code)
        file-damaged
        >>> del PARSERS["example file"]
    """

    def guarded(function: Callable[P, R]) -> Callable[P, R]:
        path = f"{function.__module__}:{function.__qualname__}"
        if name in PARSERS and PARSERS[name].path != path:
            raise ValueError(f"{path} and {PARSERS[name].path} are both the parser of {name!r}")
        PARSERS[name] = entry = Parser(name, error, max_bytes, path, function)

        @wraps(function)
        def parse(*args: P.args, **kwargs: P.kwargs) -> R:
            source = next((one for one in (*args, *kwargs.values()) if isinstance(one, str | Path)), None)
            if source is not None:
                _check_file(entry, source)
            with damage_refused(entry, source or name):
                return function(*args, **kwargs)

        return parse

    return guarded


def _check_file(entry: Parser, source: str | Path) -> None:
    """Refuse a file that is too large, or is none, such as a pipe, from which reading may never return."""
    try:
        about = Path(source).stat()
    except (OSError, ValueError):
        return  # missing, or not a path: the parser reports it in its own words
    if stat.S_ISDIR(about.st_mode):
        return
    if not stat.S_ISREG(about.st_mode):
        raise entry.error(f"{source} is not a plain file. Name a {entry.name}.", code="file-kind")
    if about.st_size > entry.max_bytes:
        raise entry.error(
            f"{source} has {about.st_size} bytes, and a {entry.name} has at most {entry.max_bytes}.",
            code="file-size",
        )


@contextmanager
def damage_refused(entry: Parser, source: str | Path) -> Iterator[None]:
    """Turn whatever is raised within into the entry's error."""
    try:
        yield
    except PalpateError:
        raise
    except OSError as e:
        if e.errno is None:  # a decoder's own, not the operating system's
            raise _damaged(entry, source, e) from e
        raise StorageError(f"{source}: {e.strerror or e}. Check the path and its permissions.") from e
    except MemoryError as e:
        raise entry.error(f"{source} needs more memory than there is.", code="file-size") from e
    except Exception as e:  # whatever a decoder meets
        raise _damaged(entry, source, e) from e


def _damaged(entry: Parser, source: str | Path, cause: Exception) -> PalpateError:
    reason = f"{type(cause).__name__}: {cause}"[:200]
    return entry.error(
        f"{source} cannot be read as a {entry.name} ({reason}). Restore it or make it again.",
        code="file-damaged",
    )

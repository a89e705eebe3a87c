"""Check of a refusal by its code, so that the words of a message can change."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from palpate.core.errors import PalpateError


@contextmanager
def refused(
    code: str, kind: type[PalpateError] = PalpateError, match: str | None = None
) -> Iterator[pytest.ExceptionInfo[PalpateError]]:
    """Expect an error of a kind with this code; the caught error is available afterwards.

    Args:
        code: Code that the error must carry.
        kind: Class of the error.
        match: Pattern of a name or value that the message must show; one or two words.
    """
    with pytest.raises(kind, match=match) as caught:
        yield caught
    assert caught.value.code == code, f"{caught.value.code!r} instead of {code!r}: {caught.value}"

"""The one place that says which version this is, and which one a file needs that this one cannot read."""

from __future__ import annotations

__version__ = "0.1.0"


def needed_version(text: bytes, own_format: str) -> str | None:
    """Say which version can read a manifest or a card that this one cannot.

    Args:
        text: of the file: a JSON object with ``format``, and ``software`` for what wrote it.
        own_format: what this version reads, such as "palpate-run/1".

    Returns:
        The sentence; None where the file's version is not the reason.
    """
    import json  # here, because the stop commands load this module and must not wait

    try:
        fields = json.loads(text)
    except (ValueError, RecursionError):
        return None
    if not isinstance(fields, dict):
        return None
    layout, software = fields.get("format"), fields.get("software")
    if isinstance(software, dict):
        software = software.get("palpate")
    writer = str(software or "").removeprefix("palpate ")
    foreign = isinstance(layout, str) and layout != own_format and layout.startswith("palpate-")
    if not foreign and _numbers(writer) <= _numbers(__version__):
        return None
    reader = f"palpate {writer}" if _numbers(writer) else "the version of palpate that wrote it"
    remedy = f"open it with {reader:.50}"
    if _numbers(writer) == _numbers(__version__):
        remedy = "so the file was altered; restore it, or make it again"
    return (
        f"has the format {layout!s:.40} of palpate {writer or 'of an unknown version':.40}, and this is "
        f"palpate {__version__}, which reads {own_format}: {remedy}"
    )


def _numbers(version: str) -> tuple[int, ...]:
    import re

    return tuple(int(part) for part in re.findall(r"\d+", version)[:3])

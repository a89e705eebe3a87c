"""Parts of pages as HTML: tables that stack on a narrow page, words that stand for a state, commands."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape


def state_word(text: str, look: str = "") -> str:
    """A state in a word, on a ground of its own; `look` is "", "warn" or "bad"."""
    return f'<span class="word {look}">{escape(text)}</span>'


def simulated_badge(simulated: bool) -> str:
    """The mark of what no real sensor gave, to stand behind a name; "" for what was measured."""
    return f" {state_word('simulated, not measured', 'warn')}" if simulated else ""


def table_html(heads: Sequence[str], rows: Sequence[Sequence[str]], look: str = "") -> str:
    """A table of cells that are HTML; on a narrow page each cell says its column's name itself.

    Args:
        look: class of the style sheet, for columns of widths of their own.
    """
    head = "".join(f"<th>{escape(name)}</th>" for name in heads)
    body = ""
    for row in rows:
        cells = zip(heads, row, strict=True)
        body += (
            "<tr>" + "".join(f'<td data-name="{escape(h)}"><div>{c}</div></td>' for h, c in cells) + "</tr>"
        )
    return f'<table class="table stacks {look}"><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>'


def progress_html(step: str, done: int, total: int, label: str) -> str:
    """How far something is: in words, in numbers and as a bar."""
    share = 100 * done / total if total else 0
    return (
        f'<div class="progress"><div class="said"><span>{escape(step)}</span><span>{done} of {total or "?"}'
        f'</span></div><div class="bar" role="progressbar" aria-label="{escape(label, quote=True)}" '
        f'aria-valuenow="{share:.0f}" aria-valuemin="0" aria-valuemax="100"><i style="width:{share:.1f}%">'
        "</i></div></div>"
    )


def trouble_html(text: str) -> str:
    """What is wrong, in a line."""
    return f'<p class="trouble">{escape(text)}</p>'


def commands_html(commands: Sequence[str]) -> str:
    """Commands as they are typed."""
    typed = escape("\n".join(commands))
    return f'<pre class="commands">{typed}</pre>'

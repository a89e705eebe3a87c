"""Verify palpate anew, and write what was found into the documentation.

    python tools/verification.py                    # print every check and every measured table
    python tools/verification.py --only light       # some checks only
    python tools/verification.py --write            # the same, into the pages under docs/

A page asks for a table by a pair of comments, `<!-- verified: light -->` or `<!-- measured: grid -->` before
it and `<!-- end -->` after it. Takes about half a minute of one core. The exit status is 1 where an error is
greater than allowed. Needs mpmath; the comparison with Mitsuba is left as it stands where that is missing.
"""

from __future__ import annotations

import argparse
import importlib.util
import re
import sys
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from oracles.measured import MEASURED

from oracles import Oracle, contact, layers, light, palm, table, tables

DOCS = Path(__file__).resolve().parents[1] / "docs"
ORACLES = {
    room.__name__.removeprefix("oracles."): room.ORACLES for room in (contact, layers, tables, light, palm)
}
HEAD = "what | against | allowed | found"
ROUNDING = 1e-14
NOT_RUN = "not run"
BLOCK = re.compile(r"<!-- (verified|measured): ([\w-]+) -->\n(.*?)<!-- end -->", re.DOTALL)


def text_of(error: float) -> str:
    """An error with two digits; rounding alone is not told from rounding."""
    if error == 0:
        return "0"
    return f"below {ROUNDING:.0e}" if error < ROUNDING else f"{error:.1e}".replace("e-0", "e-")


def error_of(text: str) -> float:
    """What `text_of` wrote."""
    return float(text.removeprefix("below "))


def rows_of(block: str) -> dict[tuple[str, str], str]:
    """What a table on a page says was found: by what was verified and against what."""
    lines = [line.strip("| ").split(" | ") for line in block.splitlines() if line.startswith("| ")][2:]
    return {(name, against): found for name, against, _, found in lines}


def found(oracle: Oracle, before: dict[tuple[str, str], str]) -> tuple[str, bool]:
    """The error, computed anew, and whether it passes; what was found before where the means are missing."""
    if oracle.needs and importlib.util.find_spec(oracle.needs) is None:
        text = before.get((oracle.name, oracle.against), NOT_RUN)
        return text, text != NOT_RUN and error_of(text) <= oracle.allowed
    error = oracle.error()
    return text_of(error), error <= oracle.allowed


def checks(room: str, texts: list[str]) -> str:
    """The table of a room's checks."""
    rows = []
    for o, text in zip(ORACLES[room], texts, strict=True):
        allowed = "0" if o.allowed == 0 else f"{o.allowed:.2g}".replace("e-0", "e-")
        rows.append(f"{o.name} | {o.against} | {allowed} | {text}")
    return table(HEAD, rows)


def blocks() -> Iterator[tuple[Path, str, str, str]]:
    """Every table that a page asks for: the page, the kind, the name and what stands there."""
    for page in sorted(DOCS.rglob("*.md")):
        for kind, name, body in BLOCK.findall(page.read_text(encoding="utf-8")):
            yield page, kind, name, body


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--write", action="store_true", help="into the pages")
    parser.add_argument("--only", choices=[*ORACLES, *MEASURED], action="append")
    args = parser.parse_args()
    wanted = args.only or [*ORACLES, *MEASURED]
    standing = {name: body for _, kind, name, body in blocks() if kind == "verified"}
    made: dict[str, str] = {}
    failed = 0
    for name in wanted:
        if name in ORACLES:
            results = [found(oracle, rows_of(standing.get(name, ""))) for oracle in ORACLES[name]]
            for oracle, (text, passes) in zip(ORACLES[name], results, strict=True):
                if not passes:
                    failed += 1
                    print(f"fails: {oracle.name} against {oracle.against}: {text}", file=sys.stderr)
            made[name] = checks(name, [text for text, _ in results])
        else:
            made[name] = MEASURED[name]()
        print(f"{name}\n\n{made[name]}\n", flush=True)
    if args.write:
        write(made)
    return 1 if failed else 0


def write(made: dict[str, str]) -> None:
    """Put the tables where the pages ask for them."""

    def filled(match: re.Match[str]) -> str:
        kind, name, body = match.groups()
        return f"<!-- {kind}: {name} -->\n{made[name] + chr(10) if name in made else body}<!-- end -->"

    for page in sorted({page for page, _, _, _ in blocks()}):
        text = page.read_text(encoding="utf-8")
        page.write_text(BLOCK.sub(filled, text), encoding="utf-8")


if __name__ == "__main__":
    raise SystemExit(main())

"""Feed damaged files to every parser of the package: python tools/fuzz_parsers.py --seconds 60 --only run.

Each parser runs in a process of its own. An input is either random bytes that begin as some kind of file
does, or a valid file with a few changes. Counted are inputs, refusals, exceptions outside palpate's own tree,
inputs that took longer than the limit, and the process's largest memory. The exit status is 1 where a parser
failed.
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import faulthandler
import json
import logging
import os
import random
import signal
import sys
import tempfile
import time
import traceback
import warnings
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from tests import parser_feeds as feeds  # noqa: E402

from palpate.core import PalpateError  # noqa: E402

LIMIT_S = 5.0  # for one input
MEMORY_BYTES = 1_000_000_000
SHOWN = 5


class LateError(BaseException):
    """An input took longer than the limit."""


def fuzz(name: str, seconds: float, count: int, seed: int) -> dict[str, object]:
    """Feed one parser; the counts."""
    feed, rng = feeds.FEEDS[name], random.Random(seed)  # noqa: S311 - not for secrets
    counts: collections.Counter[str] = collections.Counter()
    outside: list[str] = []
    signal.signal(signal.SIGALRM, lambda *_: (_ for _ in ()).throw(LateError()))
    with tempfile.TemporaryDirectory(dir="/dev/shm" if Path("/dev/shm").is_dir() else None) as place:  # noqa: S108
        folder = Path(place)
        feed.seed(folder)
        target = folder / feed.target
        valid, beside = target.read_bytes(), {p: p.read_bytes() for p in folder.rglob("*") if p.is_file()}
        with contextlib.suppress(PalpateError):
            feed.read(folder)  # imports what the parser needs
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s and counts["inputs"] < count:
            counts["inputs"] += 1
            data = feeds.random_bytes(rng) if rng.random() < 0.3 else feeds.damaged(valid, rng)
            target.write_bytes(data)
            if feed.target.startswith("cal/") and rng.random() < 0.9:
                feeds.resealed(folder, feed.target)
            signal.setitimer(signal.ITIMER_REAL, LIMIT_S)
            faulthandler.dump_traceback_later(4 * LIMIT_S, exit=True)
            try:
                feed.read(folder)
                counts["read"] += 1
            except PalpateError as e:
                counts["refused"] += 1
                counts[f"code:{e.code}"] += 1
            except LateError:
                counts["late"] += 1
            except Exception:  # what is looked for
                counts["outside"] += 1
                if len(outside) < SHOWN:
                    outside.append(traceback.format_exc()[-1500:])
            finally:
                signal.setitimer(signal.ITIMER_REAL, 0)
                faulthandler.cancel_dump_traceback_later()
            if feed.target.startswith("cal/"):
                for path, content in beside.items():
                    path.write_bytes(content)
    return {"parser": name, **counts, "memory_MB": round(peak_bytes() / 1e6), "examples": outside}


def peak_bytes() -> int:
    """Peak memory of this process; `ru_maxrss` would include that of the process it was forked from."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM:"):
            return 1024 * int(line.split()[1])
    return 0


def in_a_process(name: str, words: argparse.Namespace) -> dict[str, object]:
    """Feed one parser in a process of its own, whose crash is counted as well."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reading)
        with os.fdopen(writing, "w") as out:
            json.dump(fuzz(name, words.seconds, words.count, words.seed), out)
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading) as answer:
        text = answer.read()
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if status or not text:
        return {"parser": name, "crashed": status}
    found: dict[str, object] = json.loads(text)
    return found


def failed(found: dict[str, object]) -> bool:
    """Whether a parser raised outside the tree, hung, crashed, or took too much memory."""
    bad = any(found.get(key) for key in ("outside", "late", "crashed"))
    return bad or float(str(found.get("memory_MB", 0))) * 1e6 > MEMORY_BYTES


def main() -> None:
    """Feed the parsers that are named, or all of them."""
    words = argparse.ArgumentParser(description=__doc__)
    words.add_argument("--seconds", type=float, default=10.0, help="for each parser")
    words.add_argument("--count", type=int, default=10**9, help="most inputs for each parser")
    words.add_argument("--seed", type=int, default=0)
    words.add_argument("--only", nargs="*", default=sorted(feeds.FEEDS))
    given = words.parse_args()
    warnings.simplefilter("ignore")
    logging.disable()  # of libraries that describe damage at length
    feeds.load_every_parser()
    total, bad = 0, []
    for name in given.only:
        found = in_a_process(name, given)
        total += int(str(found.get("inputs", 0)))
        print(json.dumps(found), flush=True)
        bad += [name] * failed(found)
    print(f"{total} inputs; failed: {', '.join(bad) or 'none'}")
    sys.exit(bool(bad))


if __name__ == "__main__":
    main()

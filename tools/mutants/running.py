"""Running of mutants against their nearest tests, on a copy of the sources outside of the working tree."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import SimpleQueue

from mutants.frozen import REPOSITORY, SOURCE, Mutant

MIN_KILLED = 0.95
LIMIT_S, LIMIT_FACTOR = 60.0, 5.0  # a mutant has this and so many times its tests' own time


class Bench:
    """A copy of the sources, on which one mutant at a time is tried.

    The working tree is not touched. Compiled code is kept between mutants, and what Numba or Python compiled
    of a mutated file goes with it.
    """

    def __init__(self, folder: Path) -> None:
        self._sources = folder / "src"
        self._numba = folder / "numba"
        ignored = shutil.ignore_patterns("__pycache__", "*.egg-info")
        shutil.copytree(SOURCE, self._sources, ignore=ignored)
        self._env = os.environ | {
            "PYTHONPATH": os.pathsep.join([str(self._sources), str(REPOSITORY / "tools")]),
            "HYPOTHESIS_STORAGE_DIRECTORY": str(folder / "hypothesis"),
            "PALPATE_REAL_DATA": str(folder / "no-recordings"),  # a mutant is killed without them
            "OMP_NUM_THREADS": "1",
        }
        self._usual: dict[tuple[str, ...], float] = {}

    def tried(self, mutant: Mutant) -> dict[str, object]:
        """What became of it: killed, survived or error, by which test and in what time."""
        began = time.monotonic()
        path = self._sources / mutant.path
        original = path.read_text(encoding="utf-8")
        try:
            mutated = mutant.applied(original)
            usual = self._usual_s(mutant.tests)
            self._put(path, mutated)
            # Numba does not see that a function which it compiled into another has changed.
            numba = self._numba / mutant.id if "numba" in original else self._numba / "usual"
            code, said = self._run(mutant.tests, LIMIT_S + LIMIT_FACTOR * usual, numba)
        except (LookupError, RuntimeError) as e:
            return {"id": mutant.id, "outcome": "error", "by": str(e), "seconds": 0.0}
        finally:
            self._put(path, original)
        failed = re.search(r"^(?:FAILED|ERROR) (\S+)", said, re.MULTILINE)
        by = failed.group(1) if failed else ("time" if code is None else "")
        outcome = "survived" if code == 0 else "killed" if code in (None, 1, 2, 4) else "error"
        seconds = round(time.monotonic() - began, 1)
        return {"id": mutant.id, "outcome": outcome, "by": by, "seconds": seconds}

    def _usual_s(self, tests: tuple[str, ...]) -> float:
        """How long the tests take on the code as it is, which they must pass."""
        if tests not in self._usual:
            began = time.monotonic()
            code, said = self._run(tests, 600.0, self._numba / "usual")
            if code != 0:
                raise RuntimeError(f"{' '.join(tests)} fail without a mutant: {said[-1500:]}")
            self._usual[tests] = time.monotonic() - began
        return self._usual[tests]

    def _put(self, path: Path, source: str) -> None:
        path.write_text(source, encoding="utf-8")
        for compiled in (path.parent / "__pycache__").glob(f"{path.stem}.*"):
            compiled.unlink()

    def _run(self, tests: tuple[str, ...], limit_s: float, numba: Path) -> tuple[int | None, str]:
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-m", "not slow", "-p", "no:cacheprovider"]
        process = subprocess.Popen(  # noqa: S603
            [*command, "--hypothesis-seed=0", "--tb=no", *tests],
            cwd=REPOSITORY,
            env=self._env | {"NUMBA_CACHE_DIR": str(numba)},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )
        try:
            said, _ = process.communicate(timeout=limit_s)
            return process.returncode, said
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
            return None, ""


def run(mutants: Sequence[Mutant], processes: int) -> list[dict[str, object]]:
    """Try all, saying so line by line on stderr."""
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        benches: SimpleQueue[Bench] = SimpleQueue()
        for i in range(processes):
            benches.put(Bench(Path(folder) / str(i)))

        def tried(mutant: Mutant) -> dict[str, object]:
            bench = benches.get()
            try:
                result = bench.tried(mutant)
            finally:
                benches.put(bench)
            print("{id:4} {outcome:9}{seconds:6.1f} s  {by}".format(**result), file=sys.stderr, flush=True)
            return result

        with ThreadPoolExecutor(processes) as pool:
            return list(pool.map(tried, mutants))


def verdict(mutants: Sequence[Mutant], results: Sequence[dict[str, object]]) -> tuple[str, bool]:
    """A table of what was killed, with every survivor, and whether that is enough."""
    outcome = {str(result["id"]): result for result in results}
    killed = [m for m in mutants if outcome[m.id]["outcome"] == "killed"]
    lines = [f"{'':18}{'killed':>8}{'of':>6}"]
    for title in ("area", "kind"):
        for name in dict.fromkeys(getattr(m, title) for m in mutants):
            some = [m for m in mutants if getattr(m, title) == name]
            lines.append(f"{name:18}{sum(m in killed for m in some):8}{len(some):6}")
    share = len(killed) / len(mutants)
    lines.append(f"{'all':18}{len(killed):8}{len(mutants):6}   {share:.1%}; {MIN_KILLED:.0%} are asked")
    unexplained = False
    for m in mutants:
        if m not in killed:
            state = outcome[m.id]["outcome"]
            unexplained |= state == "error" or not m.equivalent
            why = m.equivalent if state == "survived" else outcome[m.id]["by"]
            lines += [
                "",
                f"{m.id} {state}, {m.module}: {m.function}",
                f"    - {m.line}",
                f"    + {m.mutated}",
            ]
            lines += [f"    {why or 'not explained'}"]
    return "\n".join(lines), share >= MIN_KILLED and not unexplained

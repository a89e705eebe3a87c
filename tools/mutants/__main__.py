"""Run mutants, or see to their list; tools/ is on the path.

python -m mutants                        run all; ends with 1 where too few are killed
python -m mutants --only n3 m07 --json   run some, and print what happened as JSON
python -m mutants --retarget OLD=NEW ... rename modules, functions, names or tests in the list
python -m mutants --draw                 draw the list anew from the sources as they are
"""

from __future__ import annotations

import argparse
import json
import os
import sys

from mutants.drawing import SEED, draw
from mutants.frozen import frozen, retarget, write
from mutants.running import run, verdict


def main() -> int:
    """See the module."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", nargs="+", metavar="ID", help="mutants to run")
    parser.add_argument("--json", action="store_true", help="print what happened as JSON")
    parser.add_argument("--processes", type=int, default=int(os.environ.get("MUTANT_PROCESSES") or 1))
    parser.add_argument("--draw", action="store_true", help="draw the list anew, without explanations")
    parser.add_argument("--retarget", nargs="+", metavar="OLD=NEW", help="rename in the list")
    asked = parser.parse_args()
    if asked.draw:
        write(draw(SEED), SEED)
        return 0
    if asked.retarget:
        retarget(asked.retarget)
        return 0
    mutants = [mutant for mutant in frozen() if not asked.only or mutant.id in asked.only]
    if unknown := set(asked.only or ()) - {mutant.id for mutant in mutants}:
        parser.error(f"no mutant is called {' or '.join(sorted(unknown))}")
    results = run(mutants, max(asked.processes, 1))
    table, enough = verdict(mutants, results)
    print(json.dumps(results, indent=1) if asked.json else table)
    return 0 if enough else 1


if __name__ == "__main__":
    sys.exit(main())

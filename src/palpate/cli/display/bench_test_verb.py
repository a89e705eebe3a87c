"""Verb of a display's bench test, on the virtual bench."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from typer import Option

from palpate.cli.verb_support import print_found, progress_bar

AGREES = 0.05  # of c from 1, as the wiring guide has it


def bench_test(
    table: Annotated[Path | None, Option(help="CSV of the points; must not exist.")] = None,
    figure: Annotated[Path | None, Option(help="PNG to draw; must not exist.")] = None,
    seed: Annotated[int, Option(help="Of the sensors' noise.")] = 0,
) -> None:
    """Press a virtual display at several pressures, as a bench test.

    Its force is compared with P = p A(s) + k s.

    A lab's own display takes palpate.softness.display_bench_test.run_bench_test.

    Example: palpate display bench-test --figure bench.png --json
    """
    from palpate.core import refuse_existing
    from palpate.softness.display_bench_test import write_bench_table
    from palpate.softness.virtual.indentation_bench import virtual_bench_test

    for path in (table, figure):
        if path is not None:
            refuse_existing(path)
    with progress_bar() as tell:
        test = virtual_bench_test(seed=seed, progress=tell)
    fit = test.fit()
    answer: dict[str, Any] = {
        "points": len(test.points),
        "peak_N": test.peak_n,
        "law_rms_N": test.rms_n,
        "law_rms_of_peak": test.rms_n / test.peak_n,
        "scale": fit.scale,
        "scale_standard_error": fit.scale_error,
        "sleeve_N_per_m": fit.sleeve_n_m,
        "friction_N": fit.friction_n,
        "fit_rms_N": fit.rms_n,
        "scale_within_5_percent": abs(fit.scale - 1) <= AGREES,
        "model": "simulated: no device was measured",
    }
    if table is not None:
        write_bench_table(test, table)
        answer["table"] = str(table)
    if figure is not None:
        from palpate.reports.softness_figures import write_bench_test_figure

        write_bench_test_figure(test, figure)
        answer["figure"] = str(figure)
    text = (
        f"{len(test.points)} points to {test.peak_n:.2f} N: the law P = p A(s) + k s is off by "
        f"{test.rms_n * 1e3:.2g} mN, {100 * test.rms_n / test.peak_n:.2g} % of the peak (root mean square)\n"
        f"  fitted: {fit.scale:.4f} ± {fit.scale_error:.4f} of p A(s), a sleeve of {fit.sleeve_n_m:.1f} N/m, "
        f"friction {fit.friction_n * 1e3:.1f} mN\n{answer['model']}"
    )
    print_found(answer, text)

"""Make the tables of docs/explanations/tactip.md anew, as Markdown; five minutes of one core.

    python reproductions/studies/tactip_tables.py                      # every table of the page
    python reproductions/studies/tactip_tables.py --only flow          # one part
    python reproductions/studies/tactip_tables.py --preset 331-fitted  # lever and camera fitted to real taps

Four numbers in a row are S1 / Snew / S2 / S3, stiffest first.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator, Sequence
from functools import cache

import numpy as np
from energy_contour import Contour, contours
from tactip_model_errors import (
    METHODS,
    LinearModelError,
    areas_by_friction,
    divergence_shares,
    equation_12,
    inclined_error,
    linear_error,
    peak_motion,
    press_truth,
    sensitivity,
)

from palpate.rig.virtual.linear_rig import LINEAR_RIG
from palpate.sensors.tactip import PINS_331, TacTipSpec, fitted_tactip
from palpate_reproductions.tactip.tactip_conditions import AS_IS, KAPPA_N_M, Row, compared, order
from palpate_reproductions.tactip.tactip_setup import KAPPA, under_plate

SHOWN_N = (1.0, 3.0, 5.0)
REGIONS = ("contact", "middle", "disc")
FLOW = (AS_IS, "wider pins", "tight crop")
COUNTED = (
    AS_IS, "half the speed", "twice the speed", "linear rig", "20 frames each",
    "tight crop, 20 frames each",
)  # fmt: skip
MM2 = 1e6
PRESETS = {
    "127": (TacTipSpec(), (0.0, 1.0, 2.5), (TacTipSpec(), TacTipSpec(pins=PINS_331))),
    "331-fitted": (fitted_tactip(), (0.26, 0.29, 0.33), (fitted_tactip(),)),
}
"""The sensor, lengths of pins that are tried [mm], and sensors on which methods are compared."""


def four(values: Iterable[float], digits: int = 3) -> str:
    """Values of the specimens, to so many digits."""
    return " / ".join(shown(value, digits) for value in values)


def shown(value: float, digits: int) -> str:
    """A number without an exponent."""
    text = f"{float(f'{value:.{digits}g}'):f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def line(*cells: str) -> str:
    """One row of a table."""
    return f"| {' | '.join(cells)} |"


def true_values(preset: str) -> Iterator[str]:
    """What is true, at three forces."""
    tables = [press_truth(PRESETS[preset][0], kappa, SHOWN_N) for kappa in KAPPA_N_M.values()]
    columns = {
        "contact area, mm²": [MM2 * one.area_m2 for one in tables],
        "dA/dF, mm²/N": [MM2 * one.casr_m2_n for one in tables],
        "flattening of the tip, mm": [1e3 * one.flattening_m for one in tables],
    }
    columns |= {f"divergence, {region}": [one.divergence[region] for one in tables] for region in REGIONS}
    for name, values in columns.items():
        orders = ", ".join(order([float(v[i]) for v in values]) for i in range(len(SHOWN_N)))
        yield line(name, *(four(v[i] for v in values) for i in range(len(SHOWN_N))), orders)


def sensitivities(preset: str) -> Iterator[str]:
    """Orders over tips, pins and refraction."""
    rows = sensitivity(*PRESETS[preset][:2])
    for region in REGIONS:
        some = [row for row in rows if row.region == region]
        counts = (str(sum(row.order == one for row in some)) for one in ("right", "reversed", "mixed"))
        ratios = [row.mean[-1] / row.mean[0] for row in some]
        yield line(region, *counts, f"{min(ratios):.2f} to {max(ratios):.2f}")


@cache
def conditions(preset: str) -> dict[tuple[str, str, str, str], Row]:
    """Rows by condition, source, region and way; some six seconds a condition."""
    rows = compared(tuple(dict.fromkeys((*FLOW, *COUNTED))), base=PRESETS[preset][0])
    return {(row.condition, row.source, row.region, row.way): row for row in rows}


def cell(row: Row, scale: float = 1.0) -> str:
    """Means of the specimens, and the concordance of trials."""
    return f"{four(scale * value for value in row.mean)} ({row.concordance:+.2f})"


def flow(preset: str) -> Iterator[str]:
    """What flow makes of the presses, and of the whole image with other crops."""
    rows = conditions(preset)
    for region in (*REGIONS, "whole"):
        divergence, regression, paper = (
            rows[AS_IS, "flow", region, way] for way in ("divergence", "regression", "paper")
        )
        yield line(region, cell(divergence), cell(regression, MM2), cell(paper, MM2))
        if region == "whole":
            sizes = (
                max(row.spread) * scale for row, scale in ((divergence, 1), (regression, MM2), (paper, MM2))
            )
            yield line("its spread over trials, at most", *(f"{size:.1g}" for size in sizes))
    secant, steps = (rows[AS_IS, "truth", "contact", "secant"], rows[AS_IS, "camera", "", "steps"])
    yield line("true area", "", f"{cell(secant, MM2)}, secant", f"frames: {four(steps.mean)}")
    for name in FLOW[1:]:
        yield f"whole image, {name}: {cell(rows[name, 'flow', 'whole', 'divergence'])}"


def counted(preset: str) -> Iterator[str]:
    """Equation (12) where frames, and not specimens, change."""
    yield "equation (12) of one straight line: " + four(
        equation_12(kappa) for kappa in (7600.0, 3100.0, 1100.0)
    )
    rows = conditions(preset)
    for name in COUNTED:
        yield line(name, *(cell(rows[name, "flow", region, "paper"], MM2) for region in ("contact", "disc")))
    for region in ("contact", "disc"):
        for name in COUNTED[:3]:
            yield f"secant over the {region}, {name}: {cell(rows[name, 'flow', region, 'secant'], MM2)}"
    for way in ("paper", "secant"):
        usual, slow = (np.array(rows[name, "flow", "contact", way].mean) for name in COUNTED[:2])
        yield f"{way} over the contact, at half the speed over that at the full: {four(slow / usual)}"
    usual, slow = (np.array(rows[name, "flow", "disc", "paper"].mean) for name in COUNTED[:2])
    yield f"paper over the disc, at half the speed over that at the full: {four(slow / usual)}"


def growths(preset: str) -> Iterator[str]:
    """Equation (3), at 3 N, and its extremes at all forces."""
    count, at = len(KAPPA_N_M), 1  # 3 N, of the forces 2, 3 and 4 N
    skin, image = (contours(PRESETS[preset][0], view=view) for view in ("skin", "image"))
    for first in range(0, len(skin), count):
        some = skin[first : first + count]
        cells = (_mm2(some, name, at) for name in ("area_m2", "growth_m2_n", "flux_m2_n"))
        carried = four((float(one.carried[at]) for one in image[first : first + count]), 2)
        yield line(f"{some[0].level}, {some[0].flank}", *cells, carried)
    true = skin[:count]
    yield line("true contact", _mm2(true, "contact_m2", at), _mm2(true, "casr_m2_n", at), "", "")
    for name, some in (("skin", skin), ("image", image)):
        parts = [share for one in some if one.level == "contact" for share in one.carried]
        yield f"share of the edge's growth in the {name}, 2 to 4 N: {min(parts):.2f} to {max(parts):.2f}"


def _mm2(some: Sequence[Contour], name: str, at: int) -> str:
    return four(MM2 * float(getattr(one, name)[at]) for one in some)


def seen_shares(preset: str) -> Iterator[str]:
    """How much of the true divergence each method sees, S1 and S3."""
    ends, sensors = (KAPPA_N_M["S1"], KAPPA_N_M["S3"]), PRESETS[preset][2]
    some = [one for sensor in sensors for kappa in ends for one in divergence_shares(sensor, kappa)]
    means = {(one.pins, one.kappa_n_m, one.method, one.region): one.mean for one in some}
    for method in METHODS:
        yield line(
            method,
            *(
                ", ".join(f"{means[sensor.pins.count, kappa, method, region]:.2f}" for kappa in ends)
                for sensor in sensors
                for region in ("disc", "contact")
            ),
        )


def rings(preset: str) -> Iterator[str]:
    """Where markers move outwards most, beside the contact's edge, and what of it the outermost pin moves."""
    for kappa_name, kappa in KAPPA_N_M.items():
        one = peak_motion(PRESETS[preset][0], kappa, SHOWN_N)
        peak, edge = (" / ".join(f"{np.rad2deg(v):.1f}" for v in at) for at in (one.peak_rad, one.edge_rad))
        yield line(kappa_name, peak, edge, four(one.moved_px))


def model_costs(preset: str) -> Iterator[str]:
    """Errors of the linear model, head-on and inclined, and areas by friction at 30 degrees."""
    for tip in ("base", "even"):
        for name, kappa in (("rigid", np.inf), ("S3", KAPPA_N_M["S3"])):
            one = linear_error(tip, kappa, SHOWN_N, PRESETS[preset][0])
            yield _cost_line(f"{tip}, {name}", one)
    for degrees in (30, 45):
        for name, kappa in (("rigid", np.inf), *((name, KAPPA_N_M[name]) for name in ("S1", "S2", "S3"))):
            one = inclined_error(kappa, np.deg2rad(degrees), SHOWN_N)
            if np.any(one.area):  # else there is no table, and the linear model stands beside itself
                yield _cost_line(f"base, {name} at {degrees} degrees", one)
    for friction, areas in areas_by_friction(np.deg2rad(30.0)).items():
        yield f"area at 30 degrees and 5 N, friction {friction:g}: {four(MM2 * area for area in areas)} mm²"


def _cost_line(name: str, one: LinearModelError) -> str:
    errors = (" / ".join(f"{100 * v:+.0f}" for v in values) for values in (one.approach, one.area))
    motion = " / ".join(f"{100 * v:.0f}" for v in one.motion)
    return line(name, *(f"{text} %" for text in errors), f"{motion} %")


def driven(preset: str) -> Iterator[str]:
    """Stiffness under a plate on the linear rig, by its encoder and by the command; steps and secants."""
    for over in ("encoder", "command"):
        plates = [under_plate(PRESETS[preset][0], name, 5, 0, LINEAR_RIG, over) for name in KAPPA]
        yield line(over, four(1e-3 * float(np.mean([one.slope for one in plate.lines])) for plate in plates))
    series = [1e-3 / (1e-3 / one.value + 1 / LINEAR_RIG.stiffness_n_m) for one in KAPPA.values()]
    yield line("by 1/kappa + 1/Kp", four(series))
    yield f"droop at 5 N: {1e3 * LINEAR_RIG.droop_m(5.0):.2f} mm"
    rows = conditions(preset)
    for name in (AS_IS, "linear rig"):
        cells = [cell(rows[name, "flow", region, "secant"], MM2) for region in ("contact", "disc")]
        yield line(name, cell(rows[name, "camera", "", "steps"]), *cells)


PARTS = {
    "truth": true_values,
    "sensitivity": sensitivities,
    "flow": flow,
    "counted": counted,
    "rig": driven,
    "contours": growths,
    "shares": seen_shares,
    "rings": rings,
    "costs": model_costs,
}


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", choices=list(PARTS), action="append")
    parser.add_argument("--preset", choices=list(PRESETS), default="127")
    asked = parser.parse_args()
    for name in asked.only or PARTS:
        print(f"\n{name}", *PARTS[name](asked.preset), sep="\n", flush=True)


if __name__ == "__main__":
    main()

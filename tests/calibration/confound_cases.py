"""Recordings with a known confound, and clean ones: each from a seed, as images and a table of labels.

A base gives rows in random order, whose labels are predictable by touch alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
import pandas as pd


@dataclass(frozen=True)
class Case:
    """A recording, and what an audit should name of it.

    Attributes:
        name: of base and confound.
        images: ``[n h w]`` or ``[n h w 3]``, 8-bit.
        table: labels, one row an image.
        targets: columns to calibrate.
        wanted: codes of findings of which one must be named; empty for a clean recording.
        split: how rows are held out.
    """

    name: str
    images: np.ndarray
    table: pd.DataFrame
    targets: tuple[str, ...]
    wanted: tuple[str, ...] = ()
    split: str = "random"


DRIFTING = ("outside-drifts", "order-drifts", "order-unchecked")


def eight_bit(images: np.ndarray) -> np.ndarray:
    return np.clip(np.rint(images), 0, 255).astype(np.uint8)


def _grid(height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    rows, columns = np.mgrid[:height, :width].astype(np.float32)
    return rows, columns


def pins(rng: np.random.Generator, n: int) -> Case:
    """A round field of pins in a dark frame with a bright ring; a press pushes pins outwards."""
    side, pitch = 96, 7.0
    rows, columns = _grid(side, side)
    at = np.array([(x, y) for x in np.arange(-35, 36, pitch) for y in np.arange(-35, 36, pitch)])
    at = at[np.hypot(*at.T) < 33]
    radius = np.hypot(columns - 48, rows - 48)
    ring = 160 * np.exp(-(((radius - 43) / 1.2) ** 2))
    x, y, depth = rng.uniform(-12, 12, n), rng.uniform(-12, 12, n), rng.uniform(0.5, 3.0, n)
    images = np.empty((n, side, side), np.uint8)
    for i in range(n):
        away = at - (x[i], y[i])
        moved = at + away * (0.9 * depth[i] * np.exp(-(away**2).sum(axis=1) / 250) / 6)[:, None] + 48
        picture = ring.copy()
        for px, py in moved:
            part = np.s_[int(py) - 3 : int(py) + 5, int(px) - 3 : int(px) + 5]
            picture[part] += 200 * np.exp(-((columns[part] - px) ** 2 + (rows[part] - py) ** 2) / 3)
        images[i] = eight_bit(picture + 12 + rng.normal(0, 1.5, picture.shape))
    table = pd.DataFrame({"x_mm": x / 4, "y_mm": y / 4, "depth_mm": depth})
    return Case("pins", images, table, ("depth_mm", "x_mm"))


def gel(rng: np.random.Generator, n: int) -> Case:
    """A lit gel that fills the frame, presses anywhere, light that goes everywhere with depth."""
    height, width = 60, 80
    rows, columns = _grid(height, width)
    x, y, depth = rng.uniform(5, 75, n), rng.uniform(5, 55, n), rng.uniform(0.2, 2.0, n)
    texture = cv2.GaussianBlur(rng.normal(0, 30, (height, width)).astype(np.float32), (0, 0), 1.5)
    dx, dy = columns - x[:, None, None], rows - y[:, None, None]
    bump = depth[:, None, None] * np.exp(-(dx**2 + dy**2) / (60 + 40 * depth[:, None, None]))
    images = 110 + texture + 12 * dx / 6 * bump + 5 * depth[:, None, None]
    table = pd.DataFrame({"x_mm": x / 5, "y_mm": y / 5, "depth_mm": depth})
    return Case("gel", eight_bit(images + rng.normal(0, 1.5, images.shape)), table, ("depth_mm", "x_mm"))


def spread(rng: np.random.Generator, n: int) -> Case:
    """A round skin in a bezel that shines brighter the deeper the press: light that is honest."""
    side = 80
    rows, columns = _grid(side, side)
    radius = np.hypot(columns - 40, rows - 40)
    x, y, depth = rng.uniform(-14, 14, n), rng.uniform(-14, 14, n), rng.uniform(0.3, 2.0, n)
    skin, bezel = 1 / (1 + np.exp((radius - 29) / 0.7)), np.exp(-(((radius - 34) / 3) ** 2))
    spot = np.exp(-((columns - 40 - x[:, None, None]) ** 2 + (rows - 40 - y[:, None, None]) ** 2) / 45)
    images = 30 + skin * (60 + 60 * depth[:, None, None] * spot)
    images = images + bezel * (50 + 1.5 * depth[:, None, None])
    table = pd.DataFrame({"x_mm": x / 4, "y_mm": y / 4, "depth_mm": depth})
    return Case("spread", eight_bit(images + rng.normal(0, 1.5, images.shape)), table, ("depth_mm", "x_mm"))


def bursts(rng: np.random.Generator, n: int) -> Case:
    """Five frames a press on a small part of a larger frame, held out by press."""
    presses = max(n // 5, 12)
    case = pins(rng, presses)
    images = np.repeat(case.images, 5, axis=0).astype(np.float32)
    table = case.table.loc[case.table.index.repeat(5)].reset_index(drop=True)
    table["depth_mm"] *= np.tile(np.linspace(0.99, 1.0, 5), presses)
    table.insert(0, "press", np.repeat([f"press-{i:03d}" for i in range(presses)], 5))
    noisy = eight_bit(images + rng.normal(0, 1.5, images.shape))
    return replace(case, name="bursts", images=noisy, table=table, split="group:press")


DRAWN: tuple[Callable[[np.random.Generator, int], Case], ...] = (pins, gel, spread, bursts)


def ordered(case: Case, by: str) -> Case:
    """The same rows in the order of a label, whole presses together."""
    order = np.argsort(case.table[by].to_numpy(), kind="stable")
    return replace(case, images=case.images[order], table=case.table.iloc[order].reset_index(drop=True))


def drifted(case: Case, kind: str, rng: np.random.Generator) -> Case:
    """Rows in the order of a label while something of the picture drifts with time."""
    case = lit(ordered(case, case.targets[0]), kind, rng)
    return replace(case, wanted=DRIFTING)


def lit(case: Case, kind: str, rng: np.random.Generator) -> Case:
    """Something of the picture drifts with time, at the rim most; labels stay in the order they are in."""
    images = case.images.astype(np.float32)
    n, height, width = images.shape[:3]
    time = np.linspace(0, 1, n, dtype=np.float32).reshape(n, *[1] * (images.ndim - 1))
    rows, columns = _grid(height, width)
    radius = np.hypot(2 * columns / width - 1, 2 * rows / height - 1) / np.sqrt(2)
    shape = (height, width) + (1,) * (images.ndim - 3)
    rim, side = (radius**4).reshape(shape), (columns / width - 0.5).reshape(shape)
    name = f"{case.name}, {kind} drifts"
    if kind == "brightness":
        images = images * (1 + 0.15 * time) + 6 * time
    elif kind == "gradient":
        images = images + 20 * time * side * rng.choice([-1, 1]) + 8 * time
    elif kind == "vignette":
        images = images * (1 - 0.3 * time * rim) + 10 * (1 - time) * rim
    elif kind == "colour":
        if images.ndim == 3:
            images = np.repeat(images[..., None], 3, axis=3)
            time, rim = time[..., None], rim[..., None]
        images = images * (1 + time * np.array([0.12, 0.0, -0.2], np.float32)) + 5 * time * [1, 0.5, 0]
    elif kind == "specks":
        outer = np.argwhere(radius > 0.72)
        for place in outer[rng.permutation(len(outer))[:40]]:
            begins, ends = np.sort(rng.uniform(-0.5, 1.5, 2))
            lit = ((time.reshape(-1) + rng.normal(0, 0.03, n)) > begins) & (time.reshape(-1) < ends)
            images[lit, place[0], place[1]] = 235
    return replace(case, name=name, images=eight_bit(images))


DRIFTS = ("specks", "gradient", "brightness", "vignette", "colour")


def burnt(case: Case, kind: str, rng: np.random.Generator) -> Case:
    """The first target as a text, a bar or a few grey pixels in a corner of every picture."""
    images = case.images.copy()
    n, height = images.shape[:2]
    label = case.table[case.targets[0]].to_numpy()
    share = (label - label.min()) / np.ptp(label)
    top = bool(rng.random() < 0.5)
    for i in range(n):
        if kind == "text":
            place = (1, 9) if top else (1, height - 3)
            cv2.putText(images[i], f"{label[i]:.2f}", place, cv2.FONT_HERSHEY_PLAIN, 0.6, (255,) * 3, 1)
        elif kind == "bar":
            row = 1 if top else height - 3
            images[i][row : row + 2, 1 : 2 + round(16 * share[i])] = 255
        else:
            row = 1 if top else height - 4
            images[i][row : row + 3, 1:4] = round(20 + 200 * share[i])
    return replace(
        case, name=f"{case.name}, {kind} burnt in", images=images, wanted=("burnt-in", "outside-drifts")
    )


BURNT = ("text", "bar", "pixels")


def bound(case: Case, kind: str, rng: np.random.Generator) -> Case:
    """A target more that is a function of the first."""
    a = case.table[case.targets[0]].to_numpy()
    middle = float(np.median(a)) + 0.1 * np.ptp(a) * rng.uniform(-1, 1)
    made = {
        "multiple": rng.uniform(1, 5) * a,
        "square": a**2,
        "modulus": np.abs(a - middle),
        "sign": np.sign(a - middle),
    }[kind]
    table = case.table.assign(force_N=made)
    targets = (*case.targets, "force_N")
    return replace(case, name=f"{case.name}, {kind}", table=table, targets=targets, wanted=("function",))


FUNCTIONS = ("multiple", "square", "modulus", "sign")


def copied(case: Case, kind: str, rng: np.random.Generator) -> Case:
    """A tenth of the rows again: as they are, noisier, shifted, brighter; or all in mirrored order."""
    n = len(case.images)
    rows = np.arange(n)[::-1] if kind == "mirrored order" else rng.permutation(n)[: n // 10]
    again = case.images[rows].astype(np.float32)
    if kind in ("noise", "mirrored order"):
        again = again + rng.normal(0, 3 if kind == "noise" else 1, again.shape)
    elif kind == "shift":
        again = np.roll(again, rng.choice([-1, 1]), axis=int(rng.integers(1, 3)))
    elif kind == "brightness":
        again = again * rng.choice([0.9, 1.1])
    images = np.concatenate([case.images, eight_bit(again)])
    table = pd.concat([case.table, case.table.iloc[rows]], ignore_index=True)
    if "press" in table:
        table["press"] = [*table["press"][:n], *(f"again-{name}" for name in table["press"][n:])]
    return replace(case, name=f"{case.name}, {kind}", images=images, table=table, wanted=("copies",))


COPIES = ("byte-like", "noise", "shift", "brightness", "mirrored order")


def shifted(case: Case, rng: np.random.Generator) -> Case:
    """Labels paired with the images of other rows."""
    lag = int(rng.choice([-2, -1, 1, 2]))
    table = pd.DataFrame({name: np.roll(column, lag) for name, column in case.table.items()})
    return replace(case, name=f"{case.name}, shifted by {lag}", table=table, wanted=("rows-shifted",))


CONFOUNDS: tuple[tuple[Callable, str], ...] = (
    *((drifted, kind) for kind in DRIFTS),
    *((burnt, kind) for kind in BURNT),
    *((bound, kind) for kind in FUNCTIONS),
    *((copied, kind) for kind in COPIES),
)


def confounded_case(seed: int, bases: tuple[Callable, ...], n: int = 160) -> Case:
    """Case `seed` with a confound: every kind in turn, each on another base."""
    rng = np.random.default_rng([seed, 1])
    confound, kind = CONFOUNDS[seed % len(CONFOUNDS)]
    case = bases[(seed // len(CONFOUNDS) + seed) % len(bases)](rng, n)
    return confound(case, kind, rng)


def clean_case(seed: int, bases: tuple[Callable, ...], n: int = 160) -> Case:
    """Case `seed` without a confound, of 40 to twice `n` rows; in every third the light drifts."""
    rng = np.random.default_rng([seed, 2])
    case = bases[seed % len(bases)](rng, int(rng.integers(40, 2 * n)))
    return lit(case, DRIFTS[seed // 3 % len(DRIFTS)], rng) if seed % 3 == 2 else case

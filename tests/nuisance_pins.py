"""Frames of pins as a real camera may show them, drawn at random by seed, with what stands in them.

Pins stand on a hexagonal lattice or in rings, through a wide lens, turned and shifted. Lamps are mirrored
beyond them, between them and over them; light falls off to one side, stray light brightens the ground, the
lens is out of focus, pins are hidden, pixels are noisy. The layouts are written here once more, so that
finding and drawing share no code.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial import cKDTree

MAX_BLUR = 0.28  # of the distance of neighbours: with more they are one
CLEAR_PX, BLURS = 1.0, 1.5  # px, and so many widths of blur: glare that is nearer to a pin touches it
OFF_SITE = 0.42  # pitches
TRIES = 400  # at places for glare between pins
FINE = 2  # samples a pixel, by which edges are drawn


@dataclass(frozen=True)
class Nuisances:
    """What is wrong with a frame.

    Attributes:
        rings: of pins around the middle one.
        layout: "hexagonal", or "rings" of 6 k pins on circles.
        pitch_px: in the middle [px].
        pin_share: a pin's radius in pitches.
        barrel: share by which the field's edge is drawn in, as by a wide lens.
        turn_rad: of the layout [rad].
        shift_px: of its middle from the image's [px].
        hidden: pins that are not there.
        falloff: light on the dark side, over that on the bright one.
        stray: grey levels of the ground.
        pin_level: grey levels of a pin.
        blur_px: standard deviation [px].
        lamps: mirrored beyond the pins.
        between: mirrored between them, of about a pin's size.
        over: mirrored over them, larger.
        noise: standard deviation of a pixel [grey levels].
    """

    rings: int = 6
    layout: str = "hexagonal"
    pitch_px: float = 19.0
    pin_share: float = 0.25
    barrel: float = 0.1
    turn_rad: float = 0.0
    shift_px: tuple[float, float] = (0.0, 0.0)
    hidden: int = 0
    falloff: float = 1.0
    stray: float = 18.0
    pin_level: float = 200.0
    blur_px: float = 0.7
    lamps: int = 0
    between: int = 0
    over: int = 0
    noise: float = 2.0

    @property
    def field_px(self) -> float:
        return self.rings * self.pitch_px * (1 - self.barrel)

    @property
    def size(self) -> int:
        return int(2.75 * self.field_px)


@dataclass(frozen=True)
class NuisanceFrame:
    """A frame and its truth.

    Attributes:
        image: 8-bit grey.
        pins: in sight ``[p 2]`` [px].
        cells: of each, up to a turn of the whole by sixths ``[p 2]``.
        partly: pins that glare covers in part or touches, which need not be found and may be ``[q 2]`` [px].
        everywhere: all the layout's places ``[s 2]`` [px].
        pitch_px: distance of neighbours where they are nearest [px].
    """

    image: np.ndarray
    pins: np.ndarray
    cells: np.ndarray
    partly: np.ndarray
    everywhere: np.ndarray
    pitch_px: float

    def judged(self, found: np.ndarray) -> tuple[int, int, float]:
        """How many found pins are false, how many of those in sight lost, and the greatest error [px]."""
        reach = 0.3 * self.pitch_px
        allowed = cKDTree(self.pins).query(found)[0] <= reach
        if len(self.partly):  # glare draws what is left of such a pin to itself
            allowed |= cKDTree(self.partly).query(found)[0] <= 0.5 * self.pitch_px
        false = int((~allowed).sum())
        far = cKDTree(found).query(self.pins)[0] if len(found) else np.full(len(self.pins), np.inf)
        near = far[far <= reach]
        return false, int((far > reach).sum()), float(near.max()) if len(near) else float("nan")


def drawn_at_random(seed: int) -> Nuisances:
    """All nuisances together, each from none to its greatest size."""
    rng = np.random.default_rng([seed, 19])
    rings, pitch = (6, rng.uniform(16, 22)) if rng.random() < 0.6 else (10, rng.uniform(11, 15))
    barrel = rng.uniform(0, 0.12)
    at_rim = pitch * (1 - 3 * barrel)  # rings of pins are nearest there
    return Nuisances(
        rings=rings,
        layout=str(rng.choice(["hexagonal", "rings"])),
        pitch_px=pitch,
        pin_share=rng.uniform(0.2, 0.28),
        barrel=barrel,
        turn_rad=rng.uniform(-np.pi, np.pi),
        shift_px=tuple(rng.uniform(-6, 6, 2)),
        hidden=int(rng.integers(0, 21)),
        falloff=rng.uniform(0.6, 1),
        stray=rng.uniform(8, 50),
        pin_level=rng.uniform(130, 220),
        blur_px=rng.uniform(0.5, min(3.0, MAX_BLUR * at_rim)),
        lamps=int(rng.integers(3, 13)),
        between=int(rng.integers(0, 6)),
        over=int(rng.integers(0, 3)),
        noise=rng.uniform(1, 3),
    )


def layout_cells(rings: int) -> np.ndarray:
    steps = range(-rings, rings + 1)
    return np.array([(i, j) for i in steps for j in steps if abs(i + j) <= rings])


def layout_places(cells: np.ndarray, layout: str) -> np.ndarray:
    """Places in pitches: of a hexagonal lattice, or with each hexagon of it stretched to a circle."""
    i, j = cells.T.astype(float)
    plane = np.stack([i + j / 2, np.sqrt(0.75) * j], axis=1)
    if layout == "hexagonal":
        return plane
    ring = np.maximum(np.maximum(abs(i), abs(j)), abs(i + j))
    # Along each side of a hexagon, pins that stood at even steps stand at even angles.
    side = np.floor(np.arctan2(plane[:, 1], plane[:, 0]) / (np.pi / 3) + 1e-9)
    from_corner = np.hypot(*(plane - ring[:, None] * _at_angle(side * np.pi / 3)).T)
    return ring[:, None] * _at_angle((side + from_corner / np.maximum(ring, 1)) * np.pi / 3)


def _at_angle(angle: np.ndarray) -> np.ndarray:
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def frame_of(what: Nuisances, seed: int) -> NuisanceFrame:
    """Draw a frame; the seed places what has no place of its own."""
    rng = np.random.default_rng(seed)
    cells = layout_cells(what.rings)
    places = _seen(layout_places(cells, what.layout), what)
    near = cKDTree(places).query(places, k=2)[0][:, 1]
    visible = np.ones(len(cells), bool)
    visible[rng.permutation(len(cells))[: what.hidden]] = False
    radius = what.pin_share * near
    y, x = np.mgrid[: what.size, : what.size]
    glare = [*_lamps(what, rng), *_between(what, places, radius, visible, rng), *_over(what, rng)]
    covered, partly = _hidden_by(glare, places, radius, what, x, y)
    partly &= visible
    drawn = visible & ~covered
    visible = drawn & ~partly
    share = _discs(places[drawn], radius[drawn], what.size)
    image = _light(what, x, y, rng) * (what.stray + share * (what.pin_level - what.stray))
    for one in glare:
        image = np.maximum(image, _blob(x, y, one))
    image = cv2.GaussianBlur(image, (0, 0), what.blur_px)
    image = image + what.noise * rng.standard_normal(image.shape)
    pixels = np.clip(np.rint(image), 0, 255).astype(np.uint8)
    return NuisanceFrame(pixels, places[visible], cells[visible], places[partly], places, float(near.min()))


def _seen(plane: np.ndarray, what: Nuisances) -> np.ndarray:
    c, s = _at_angle(what.turn_rad)
    drawn_in = 1 - what.barrel * (plane**2).sum(axis=1, keepdims=True) / what.rings**2
    middle = (what.size - 1) / 2 + np.array(what.shift_px)
    return middle + what.pitch_px * drawn_in * (plane @ np.array([[c, s], [-s, c]]))


def _light(what: Nuisances, x: np.ndarray, y: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """1 on the bright side of the field, and the falloff on the other."""
    angle = rng.uniform(0, 2 * np.pi)
    across = (x * np.cos(angle) + y * np.sin(angle)) - (what.size - 1) / 2 * (np.cos(angle) + np.sin(angle))
    return 1 - (1 - what.falloff) * np.clip(0.5 + across / (2 * what.field_px), 0, 1)


def _discs(places: np.ndarray, radius: np.ndarray, size: int) -> np.ndarray:
    """Share of each pixel that discs cover."""
    fine = np.zeros((FINE * size, FINE * size), np.float32)
    for (px, py), r in zip(places, radius, strict=True):
        low = np.maximum(np.floor([px - r - 1, py - r - 1]).astype(int), 0)
        end = np.minimum(np.ceil([px + r + 2, py + r + 2]).astype(int), size)
        sub = (np.arange(FINE * low[0], FINE * end[0]) + 0.5) / FINE - 0.5
        down = (np.arange(FINE * low[1], FINE * end[1]) + 0.5) / FINE - 0.5
        cover = np.clip(FINE * (r - np.hypot(sub[None] - px, down[:, None] - py)) + 0.5, 0, 1)
        part = fine[FINE * low[1] : FINE * end[1], FINE * low[0] : FINE * end[0]]
        np.maximum(part, cover, out=part)
    return fine.reshape(size, FINE, size, FINE).mean(axis=(1, 3)).astype(float)


@dataclass(frozen=True)
class Glare:
    """An ellipse of one brightness; half axes [px], angle of the longer [rad]."""

    middle: np.ndarray
    long: float
    short: float
    angle: float
    level: float


def _lamps(what: Nuisances, rng: np.random.Generator) -> list[Glare]:
    """In a ring beyond the pins, along the rim, brighter than pins."""
    made = []
    start, spread = rng.uniform(0, 2 * np.pi), what.field_px * rng.uniform(1.14, 1.3)
    for k in range(what.lamps):
        angle = start + 2 * np.pi * (k + rng.uniform(-0.2, 0.2)) / what.lamps
        at = (what.size - 1) / 2 + np.array(what.shift_px) + spread * _at_angle(angle)
        short = rng.uniform(0.2, 0.5) * what.pitch_px
        made.append(Glare(at, short * rng.uniform(1, 3), short, angle + np.pi / 2, rng.uniform(200, 255)))
    return made


def _between(
    what: Nuisances, places: np.ndarray, radius: np.ndarray, visible: np.ndarray, rng: np.random.Generator
) -> list[Glare]:
    """Reflections of about a pin's size in gaps, so wide apart from pins that they do not merge.

    None stands where a pin is hidden: nothing would tell it from that pin.
    """
    made: list[Glare] = []
    for _ in range(TRIES):
        if len(made) == what.between:
            break
        at = (what.size - 1) / 2 + rng.uniform(-0.95, 0.95, 2) * what.field_px
        away = np.hypot(*(places - at).T)
        room = float((away - radius)[visible].min()) - CLEAR_PX - BLURS * what.blur_px
        if room > 0.1 * what.pitch_px and away.min() > OFF_SITE * what.pitch_px:
            size = min(room, rng.uniform(0.1, 0.3) * what.pitch_px)
            made.append(Glare(at, size, size, 0.0, rng.uniform(170, 255)))
    return made


def _over(what: Nuisances, rng: np.random.Generator) -> list[Glare]:
    """Larger than pins, and anywhere among them."""
    made = []
    for _ in range(what.over):
        at = (what.size - 1) / 2 + rng.uniform(-0.8, 0.8, 2) * what.field_px
        size = rng.uniform(0.5, 1.3) * what.pitch_px
        made.append(Glare(at, size, size, 0.0, 255.0))
    return made


def _hidden_by(
    glare: list[Glare], places: np.ndarray, radius: np.ndarray, what: Nuisances, x: np.ndarray, y: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Which pins glare covers whole, and which it covers in part or touches once blurred."""
    free = np.ones(x.shape, np.uint8)
    for one in glare:
        free[_away(x, y, one) <= 1] = 0
    outside, inside = (cv2.distanceTransform(mask, cv2.DIST_L2, 5) for mask in (free, 1 - free))
    column, row = np.clip(np.rint(places), 0, what.size - 1).astype(int).T
    covered = inside[row, column] > radius
    return covered, ~covered & (outside[row, column] < radius + CLEAR_PX + BLURS * what.blur_px)


def _away(x: np.ndarray, y: np.ndarray, one: Glare) -> np.ndarray:
    """Distance from the middle in half axes."""
    c, s = _at_angle(one.angle)
    u, v = (
        (x - one.middle[0]) * c + (y - one.middle[1]) * s,
        (y - one.middle[1]) * c - (x - one.middle[0]) * s,
    )
    return np.hypot(u / one.long, v / one.short)


def _blob(x: np.ndarray, y: np.ndarray, one: Glare) -> np.ndarray:
    """One brightness with a halo of a fifth of it."""
    away = _away(x, y, one)
    core = one.level * np.clip((1 - away) * one.short + 0.5, 0, 1)
    return np.maximum(core, 0.2 * one.level * np.exp(-0.5 * (away / 1.3) ** 2))

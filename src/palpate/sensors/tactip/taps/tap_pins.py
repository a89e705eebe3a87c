"""Pins of separate taps of a TacTip given their identities, from images and known poses alone.

Taps are no sequence, so that no pin can be followed. The pins at rest are those of a shallow upright tap;
taps are then taken from mild poses outward. Where a tap's pins should be is told by a polynomial of the pose
through all taps before it; what the tap itself does beside that (slip, a pose error) is a smooth field of the
place, found from the pins that are nearest already. A pin is the spot that is nearest to where it should be,
and whose nearest pin it is.

`mislabelled` is the check: a tap whose pins were given others' names has moved its whole field against the
pose by about a spacing, or lost a border of pins, or folded the lattice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial import Delaunay, cKDTree

from palpate.core import Bool, Float, InputError, UInt8, ndarray
from palpate.sensors.tactip.taps.pose_polynomial import PosePolynomial, monomials, told_by

Spots = Float[ndarray, "s 2"]
Layout = Float[ndarray, "p 2"]

MIN_AREA, MAX_AREA = 0.4, 1.9  # of the median spot's: smaller are specks, larger run together
SPECK_PX = 20.0  # spots below this area never count, so that a thousand specks cannot be the median [px^2]
ROUND = 0.55  # least share of its box that a spot fills; a disc fills 0.79
GATE = 0.45  # of a pin's distance to its neighbour: how far from where it should be it is looked for
STAGES = ((0.05, 1), (0.1, 1), (0.2, 2), (0.4, 2), (0.7, 2), (1.0, 2), (1.0, 3), (1.0, 3))
OWN_FIELD = (0, 1, 2, 3)  # degrees of a tap's own field, in turn
MIN_SHARE = 0.95  # of pins that a well-labelled tap has
MAX_SHIFT = 0.5  # of a spacing, by which a tap's whole field may be off its pose's


@dataclass(frozen=True)
class TapPins:
    """Pins of taps.

    Attributes:
        rest_px: of every pin in the tap that began it (x, y) ``[p 2]`` [px].
        places_px: of every tap's pins, NaN where one was not identified ``[t p 2]`` [px].
        expected_px: where the poses alone would have them ``[t p 2]`` [px].
    """

    rest_px: Layout
    places_px: Float[ndarray, "t p 2"]
    expected_px: Float[ndarray, "t p 2"]

    @property
    def share(self) -> Float[ndarray, " t"]:
        """Share of the pins identified in every tap."""
        return np.asarray(np.isfinite(self.places_px[..., 0]).mean(axis=1))

    @property
    def mislabelled(self) -> Bool[ndarray, " t"]:
        """Taps whose pins bear wrong names."""
        return np.array([
            not well_labelled(self.rest_px, places, expected)
            for places, expected in zip(self.places_px, self.expected_px, strict=True)
        ])  # fmt: skip


def spots(image: UInt8[ndarray, "h w"]) -> Spots:
    """Centres (x, y) of the round bright spots of one size in a binarised image [px]."""
    _, _, stats, centres = cv2.connectedComponentsWithStats((image > 127).astype(np.uint8), connectivity=4)
    box = np.asarray(stats[1:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]], np.float64)
    area, at = np.asarray(stats[1:, cv2.CC_STAT_AREA], np.float64), np.asarray(centres[1:], np.float64)
    large = area > SPECK_PX
    if not large.any():
        return np.zeros((0, 2))
    usual = np.median(area[large])
    fits = large & (area > MIN_AREA * usual) & (area < MAX_AREA * usual)
    return at[fits & (area > ROUND * box.prod(axis=1)) & (box.max(axis=1) < 1.8 * box.min(axis=1))]


def spacing(layout: Layout) -> Float[ndarray, " p"]:
    """Distance of every pin to its nearest neighbour [px]."""
    return np.asarray(cKDTree(layout).query(layout, 2)[0][:, 1])


def matched(expected: Layout, found: Spots) -> Layout:
    """For every pin the spot that is nearest to where it should be and whose nearest pin it is; else NaN."""
    places = np.full_like(expected, np.nan)
    if not len(found):
        return places
    off, spot = cKDTree(found).query(expected)
    back = cKDTree(expected).query(found)[1]
    mine = (back[spot] == np.arange(len(expected))) & (off < GATE * spacing(expected))
    places[mine] = found[spot[mine]]
    return places


def identified(expected: Layout, found: Spots) -> Layout:
    """Pins of one tap, found by fields of rising degree from where its pose would have them; else NaN."""
    at, guess = _scaled(expected), expected
    for degree in OWN_FIELD:
        places = matched(guess, found)
        seen = np.isfinite(places[:, 0])
        basis = monomials(at, degree)
        if seen.sum() < 4 * basis.shape[1]:
            break
        field = np.linalg.lstsq(basis[seen], (places - expected)[seen], rcond=None)[0]
        off = np.linalg.norm((places - expected - basis @ field)[seen], axis=1)
        keep = np.flatnonzero(seen)[off <= 3 * np.median(off) + 0.5]
        guess = expected + basis @ np.linalg.lstsq(basis[keep], (places - expected)[keep], rcond=None)[0]
    return matched(guess, found)


def identified_taps(
    found: Sequence[Float[ndarray, "_ 2"]],
    poses: Float[ndarray, "t q"],
    rest: Layout,
    upright: Float[ndarray, " q"],
) -> TapPins:
    """Pins of many taps.

    Args:
        found: spots of every tap [px].
        poses: of every tap, in any units.
        rest: pins of a tap at or near `upright` [px].
        upright: the pose from which mildness counts; at which pins stand as in `rest`.

    Raises:
        InputError: fewer than 50 taps, or not one pose a tap.
    """
    if len(found) != len(poses) or len(found) < 50:
        raise InputError(f"{len(found)} taps with {len(poses)} poses; one pose a tap, and 50 taps or more")
    mild = np.argsort(np.linalg.norm((poses - upright) / poses.std(axis=0), axis=1))
    places = np.full((len(found), *rest.shape), np.nan)
    expected = np.repeat(rest[None], len(found), axis=0)
    for share, degree in STAGES:
        now = mild[: max(20, int(share * len(found)))]
        for tap in now:
            places[tap] = identified(expected[tap], found[tap])
        expected = PosePolynomial.fitted(poses[now], places[now], told_by(poses[now], degree)).at(poses)
    for tap in range(len(found)):
        places[tap] = identified(expected[tap], found[tap])
    return TapPins(rest, places, expected)


def rest_layout(found: Sequence[Float[ndarray, "_ 2"]], count: int) -> Layout:
    """The pins of the first tap that shows exactly as many spots within their disc as there are pins [px].

    Raises:
        InputError: no tap shows that many.
    """
    for at in found:
        if len(at) < count:
            continue
        middle = np.median(at, axis=0)
        order = np.argsort(np.linalg.norm(at - middle, axis=1))
        inside = at[order[:count]]
        reach = np.linalg.norm(inside - middle, axis=1)[-1]
        beyond = np.linalg.norm(at[order[count:]] - middle, axis=1)
        if not (beyond < reach + 0.4 * np.median(spacing(inside))).any():
            return inside
    raise InputError(f"none of {len(found)} taps shows {count} spots with nothing near around them")


def well_labelled(rest: Layout, places: Layout, expected: Layout) -> bool:
    """Whether a tap's pins bear their own names.

    They do where nearly all were found, the median one is within half a spacing of where its pose would have
    it, and the triangles between neighbours kept their orientation.
    """
    seen = np.isfinite(places[:, 0])
    if seen.mean() < MIN_SHARE:
        return False
    off = np.linalg.norm((places - expected)[seen], axis=1) / spacing(expected)[seen]
    if np.median(off) > MAX_SHIFT:
        return False
    return folded(rest[seen], places[seen]) == 0


def folded(rest: Layout, places: Layout) -> int:
    """Triangles between neighbouring pins that the tap has turned over."""
    corners = Delaunay(rest).simplices
    flat = np.abs(_twice_area(rest[corners])) < 0.3 * np.median(np.abs(_twice_area(rest[corners])))
    turned = _twice_area(rest[corners]) * _twice_area(places[corners]) <= 0
    return int((turned & ~flat).sum())


def _twice_area(corners: Float[ndarray, "n 3 2"]) -> Float[ndarray, " n"]:
    a, b = (corners[:, 1:] - corners[:, :1]).transpose(1, 0, 2)
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def _scaled(layout: Layout) -> Layout:
    return np.asarray((layout - layout.mean(axis=0)) / layout.std())

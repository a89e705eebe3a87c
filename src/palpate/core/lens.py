"""The lens of a camera: where a direction falls on its image, and back.

Camera frame: x to the right along image rows, y down along its columns, z along the optical axis away from
the camera [m]. Pixels are (x, y), column before row, and whole numbers are the centres of pixels,
as OpenCV has them.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy import ndarray

from palpate.core.errors import ImageError, InputError
from palpate.core.files import PathText, new_file
from palpate.core.parsing import parser
from palpate.core.shapes import Float

SCHEMA = "palpate-lens/1"
LensModel = Literal["kannala-brandt", "pinhole"]
COEFFICIENTS = {"kannala-brandt": 4, "pinhole": 5}
MAX_SIDE_PX = 20_000
MAX_LENS_BYTES = 1_000_000
NODES = 1024  # of the table where Newton's method begins
NEWTON_STEPS = 40
ROUNDING_RAD = 1e-15
MAX_RESIDUAL = 1e-12  # of normalised image coordinates: what a solution may leave, about 1e-9 px

Pairs = Float[ndarray, "*n xy"]
Triples = Float[ndarray, "*n xyz"]


@dataclass(frozen=True, slots=True)
class Lens:
    """A calibrated lens and camera: Kannala-Brandt fisheye, or pinhole with Brown-Conrady distortion.

    With (x, y, z) a point, r = hypot(x, y) / z and theta = atan2(hypot(x, y), z) its angle from the axis,
    "kannala-brandt" places it at theta (1 + k1 theta² + k2 theta⁴ + k3 theta⁶ + k4 theta⁸) from the centre,
    in focal lengths (doi:10.1109/TPAMI.2006.153, as `cv2.fisheye` writes it), and "pinhole" at
    r (1 + k1 r² + k2 r⁴ + k3 r⁶) with tangential terms p1, p2 (Brown 1971, as `cv2.projectPoints` writes it).

    Beyond the angle where these polynomials turn back, or beyond `max_angle_rad`, there is no answer: every
    method gives NaN there, never a number that another direction has.

    Attributes:
        model: "kannala-brandt" or "pinhole".
        focal_px: (fx, fy), focal lengths [px].
        centre_px: (cx, cy), where the optical axis meets the image [px].
        distortion: (k1, k2, k3, k4) of a fisheye; (k1, k2, p1, p2, k3) of a pinhole, OpenCV's order.
        size_px: (height, width) of the camera's frames [px].
        max_angle_rad: largest angle from the axis for which the numbers were fitted [rad]; None leaves it
            to the polynomial alone.
        name: what the user calls it; not part of `id`.
    """

    model: LensModel
    focal_px: tuple[float, float]
    centre_px: tuple[float, float]
    distortion: tuple[float, ...]
    size_px: tuple[int, int]
    max_angle_rad: float | None = None
    name: str = ""

    def __post_init__(self) -> None:
        if self.model not in get_args(LensModel):
            raise InputError(f"lens model {self.model!r}; there are {', '.join(get_args(LensModel))}")
        kinds = {"focal_px": float, "centre_px": float, "distortion": float, "size_px": int}
        for field, kind in kinds.items():
            object.__setattr__(self, field, tuple(kind(value) for value in getattr(self, field)))
        wanted = COEFFICIENTS[self.model]
        if len(self.distortion) != wanted:
            raise InputError(
                f"{len(self.distortion)} distortion coefficients; a {self.model} lens has {wanted}, "
                + ("k1, k2, k3, k4" if wanted == 4 else "k1, k2, p1, p2, k3")
            )
        if len(self.focal_px) != 2 or len(self.centre_px) != 2 or len(self.size_px) != 2:
            raise InputError("focal_px is (fx, fy), centre_px (cx, cy), size_px (height, width)")
        if not all(math.isfinite(value) for value in (*self.focal_px, *self.centre_px, *self.distortion)):
            raise InputError("focal lengths, centre and distortion of a lens are finite numbers")
        if min(self.focal_px) <= 0:
            raise InputError(f"focal lengths {self.focal_px} px; give both above 0 px")
        if min(self.size_px) < 1 or max(self.size_px) > MAX_SIDE_PX:
            raise InputError(f"size {self.size_px} px; give height and width of 1 to {MAX_SIDE_PX} px")
        if self.max_angle_rad is not None:
            object.__setattr__(self, "max_angle_rad", float(self.max_angle_rad))
            if not 0 < self.max_angle_rad <= math.pi:
                raise InputError(f"max_angle_rad is {self.max_angle_rad}; give an angle above 0, pi at most")

    @property
    def id(self) -> str:
        """First 16 hexadecimal digits of the SHA-256 of its numbers: the same numbers, the same id."""
        numbers = {key: value for key, value in self._numbers().items() if key != "name"}
        return hashlib.sha256(json.dumps(numbers, sort_keys=True).encode()).hexdigest()[:16]

    @property
    def field_rad(self) -> float:
        """Largest angle from the axis that has a place on the image plane [rad].

        Where the polynomial turns back, or `max_angle_rad`, whichever comes first; for a pinhole below pi/2.
        """
        return _reach(self)[0]

    @property
    def matrix(self) -> Float[ndarray, "3 3"]:
        """Camera matrix [px]."""
        (fx, fy), (cx, cy) = self.focal_px, self.centre_px
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    def project(self, points: Triples) -> Pairs:
        """Places of points on the image [px].

        Args:
            points: (x, y, z) in the camera frame, shape [..., 3], in m or any one unit of length.

        Returns:
            (x, y), shape [..., 2], inside or outside the frame's borders; NaN beyond `field_rad`, at the lens
            itself, and where a coordinate is not finite.
        """
        points = _of_width(points, 3, "points")
        return self._normalised(points) * self.focal_px + self.centre_px

    def rays(self, places_px: Pairs) -> Triples:
        """Unit directions, in the camera frame, of places on the image.

        Args:
            places_px: (x, y), shape [..., 2].

        Returns:
            Directions, shape [..., 3]; NaN for places that no direction within `field_rad` reaches.
        """
        places = (_of_width(places_px, 2, "places") - self.centre_px) / np.array(self.focal_px)
        return _fisheye_rays(self, places) if self.model == "kannala-brandt" else _pinhole_rays(self, places)

    def flat(
        self, focal_px: tuple[float, float] | None = None, size_px: tuple[int, int] | None = None
    ) -> Lens:
        """The pinhole without distortion that frames are rectified onto, about the same axis.

        Args:
            focal_px: of that pinhole [px]; None takes the lens's own, so that the centre keeps its scale.
            size_px: (height, width) of its image [px], with the axis at the same part of the frame; None
                takes the lens's own size.
        """
        height, width = self.size_px if size_px is None else size_px
        tall, wide = height / self.size_px[0], width / self.size_px[1]
        centre = ((self.centre_px[0] + 0.5) * wide - 0.5, (self.centre_px[1] + 0.5) * tall - 0.5)
        return Lens("pinhole", focal_px or self.focal_px, centre, (0.0,) * 5, (height, width))

    def undistorted(self, places_px: Pairs, onto: Lens | None = None) -> Pairs:
        """Places on the image of another lens of the same axis that sees the same [px].

        Args:
            places_px: on this lens's image, (x, y), shape [..., 2].
            onto: the other lens; None is `flat()`: straight lines straight, the lens's own focal lengths,
                centre and size.

        Returns:
            (x, y), shape [..., 2]; NaN where either lens has no answer.
        """
        return (onto or self.flat()).project(self.rays(places_px))

    def check_size(self, size_px: tuple[int, int]) -> None:
        """Refuse a frame of another camera.

        Args:
            size_px: (height, width) of the frame [px].
        """
        if tuple(size_px) != self.size_px:
            (height, width), (tall, wide) = size_px, self.size_px
            raise ImageError(
                f"the frame has {width}x{height} px, and lens {self.name or self.id} was calibrated on "
                f"frames of {wide}x{tall} px; give frames of that size, or this camera's lens",
                code="image-size",
            )

    def card(self) -> dict[str, Any]:
        """The content of a lens file, which `from_card` reads: schema, id and numbers."""
        return {"schema": SCHEMA, "id": self.id, **self._numbers()}

    @classmethod
    @parser("lens card", InputError)
    def from_card(cls, card: Any, where: str = "lens") -> Lens:
        """The lens of a lens file's content; what else stands in it is passed over.

        Args:
            card: as `card` gives it.
            where: what a message calls it.
        """
        if not isinstance(card, Mapping) or card.get("schema") != SCHEMA:
            found = card.get("schema") if isinstance(card, Mapping) else type(card).__name__
            raise InputError(f"{where}: schema is {found!r}; a lens file states {SCHEMA!r}", code="schema")
        try:
            focal, centre, distortion, size = (
                tuple(card[field]) for field in ("focal_px", "centre_px", "distortion", "size_px")
            )
            lens = cls(
                card["model"],
                focal,
                centre,
                distortion,
                size,
                card["max_angle_rad"],
                str(card.get("name", "")),
            )
        except KeyError as error:
            raise InputError(f"{where}: {error} is missing from the lens file") from error
        except (TypeError, ValueError) as error:
            raise InputError(f"{where}: {error}", code="lens-numbers") from error
        if card.get("id") != lens.id:
            raise InputError(
                f"{where}: its numbers belong to lens {lens.id}, and it states {card.get('id')}; a lens file "
                "is not edited by hand: write it anew, by palpate lens calibrate or Lens.write",
                code="lens-id",
            )
        return lens

    def write(self, path: PathText) -> None:
        """Write a lens file of its numbers alone."""
        with new_file(Path(path)) as building:
            building.write_text(json.dumps(self.card(), indent=1) + "\n", encoding="utf-8")

    @classmethod
    @parser("lens file", InputError, max_bytes=MAX_LENS_BYTES)
    def read(cls, path: PathText) -> Lens:
        """Read a lens file."""
        place = Path(path)
        try:
            if place.stat().st_size > MAX_LENS_BYTES:
                raise InputError(f"{place} has more than {MAX_LENS_BYTES} bytes; it is no lens file")
            card = json.loads(place.read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"{place} cannot be read as a lens file: {error}") from error
        return cls.from_card(card, str(place))

    def _numbers(self) -> dict[str, Any]:
        return {
            "model": self.model,
            "focal_px": list(self.focal_px),
            "centre_px": list(self.centre_px),
            "distortion": list(self.distortion),
            "size_px": list(self.size_px),
            "max_angle_rad": self.max_angle_rad,
            "name": self.name,
        }

    def _normalised(self, points: np.ndarray) -> np.ndarray:
        """Places in focal lengths from the centre."""
        across, z = points[..., :2], points[..., 2]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            radius = np.hypot(across[..., 0], across[..., 1])
            theta = np.arctan2(radius, z)
            seen = (theta <= self.field_rad) & (np.hypot(radius, z) > 0)
            if self.model == "kannala-brandt":
                along = np.where(radius > 0, _fisheye_radius(self, theta) / radius, 1 / z)
                places = across * along[..., None]
            else:
                flat = across / z[..., None]
                a, b, d = _brown_conrady_slopes(self, flat)
                places, seen = _brown_conrady(self, flat), seen & (a * d - b * b > 0)
        return np.where(seen[..., None], places, np.nan)


def _of_width(values: Any, width: int, what: str) -> np.ndarray:
    array = np.asarray(values, dtype=float)
    if array.ndim < 1 or array.shape[-1] != width:
        raise InputError(f"{what} have shape {array.shape}; give [..., {width}]", code="shape")
    return array


def _radial(lens: Lens) -> tuple[float, ...]:
    """Coefficients of the powers 0, 2, 4, ... of theta or r that scale it."""
    if lens.model == "kannala-brandt":
        return (1.0, *lens.distortion)
    k1, k2, _, _, k3 = lens.distortion
    return (1.0, k1, k2, k3)


@lru_cache(maxsize=64)
def _reach(lens: Lens) -> tuple[float, float]:
    """Largest theta or angle [rad], and the largest argument (theta or r), where the radius still grows."""
    slope = [(2 * power + 1) * factor for power, factor in enumerate(_radial(lens))]
    while slope[-1] == 0.0:
        slope.pop()
    squares = np.roots(slope[::-1]) if len(slope) > 1 else np.zeros(0)
    # A double root, where the slope only touches zero, has a small imaginary part by rounding: it counts.
    turns = [root.real for root in squares if root.real > 0 and abs(root.imag) < 1e-7 * abs(root)]
    turn = math.sqrt(min(turns)) if turns else math.inf
    if lens.model == "kannala-brandt":
        limit = min(turn, math.pi, lens.max_angle_rad or math.inf)
        return limit, limit
    angle = min(math.atan(turn), np.nextafter(math.pi / 2, 0.0), lens.max_angle_rad or math.inf)
    return angle, math.tan(angle)


def _fisheye_radius(lens: Lens, theta: Any) -> Any:
    return theta * np.polyval(_radial(lens)[::-1], theta * theta)


def _fisheye_slope(lens: Lens, theta: Any) -> Any:
    slope = [(2 * power + 1) * factor for power, factor in enumerate(_radial(lens))]
    return np.polyval(slope[::-1], theta * theta)


def _fisheye_rays(lens: Lens, places: np.ndarray) -> np.ndarray:
    radius = np.hypot(places[..., 0], places[..., 1])
    nodes = np.linspace(0.0, lens.field_rad, NODES)
    heights = _fisheye_radius(lens, nodes)
    # Between two nodes the radius grows, so a Newton step that leaves them is halved back into them.
    place = np.clip(np.searchsorted(heights, radius), 1, NODES - 1)
    low, high = nodes[place - 1], nodes[place]
    theta = (low + high) / 2
    with np.errstate(divide="ignore", invalid="ignore"):
        for _ in range(NEWTON_STEPS):
            over = _fisheye_radius(lens, theta) - radius
            low, high = np.where(over < 0, theta, low), np.where(over < 0, high, theta)
            stepped = theta - over / _fisheye_slope(lens, theta)
            before, theta = theta, np.where((stepped >= low) & (stepped <= high), stepped, (low + high) / 2)
            if not (np.abs(theta - before) > ROUNDING_RAD).any():
                break
        left = np.abs(_fisheye_radius(lens, theta) - radius)
        seen = np.isfinite(radius) & (left <= MAX_RESIDUAL * np.maximum(1.0, radius))
        across = np.where(radius[..., None] > 0, places / radius[..., None], 0.0)
    rays = np.concatenate([across * np.sin(theta)[..., None], np.cos(theta)[..., None]], axis=-1)
    return np.where(seen[..., None], rays, np.nan)


def _brown_conrady(lens: Lens, flat: np.ndarray) -> np.ndarray:
    """Distorted places of undistorted ones, both in focal lengths from the centre."""
    x, y = flat[..., 0], flat[..., 1]
    _, _, p1, p2, _ = lens.distortion
    square = x * x + y * y
    radial = np.polyval(_radial(lens)[::-1], square)
    return np.stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x),
            y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y,
        ],
        axis=-1,
    )


def _brown_conrady_slopes(lens: Lens, flat: np.ndarray) -> tuple[Any, Any, Any]:
    """Derivatives of the distorted place: its x by x, by y (which is its y by x), its y by y."""
    x, y = flat[..., 0], flat[..., 1]
    k1, k2, p1, p2, k3 = lens.distortion
    square = x * x + y * y
    radial = np.polyval(_radial(lens)[::-1], square)
    steep = 2 * np.polyval((3 * k3, 2 * k2, k1), square)
    return (
        radial + steep * x * x + 2 * p1 * y + 6 * p2 * x,
        steep * x * y + 2 * p1 * x + 2 * p2 * y,
        radial + steep * y * y + 6 * p1 * y + 2 * p2 * x,
    )


def _pinhole_rays(lens: Lens, places: np.ndarray) -> np.ndarray:
    """Newton's method from the radial solution; what does not arrive within the field is NaN."""
    _, farthest = _reach(lens)
    radius = np.hypot(places[..., 0], places[..., 1])
    last = min(farthest, 2.0 * float(np.max(radius, initial=0.0, where=np.isfinite(radius))) + 1.0)
    nodes = np.linspace(0.0, last if math.isinf(farthest) or farthest > 1e6 else farthest, NODES)
    heights = nodes * np.polyval(_radial(lens)[::-1], nodes * nodes)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        scale = np.where(radius > 0, np.interp(radius, heights, nodes) / radius, 1.0)
        flat = places * scale[..., None]
        for _ in range(NEWTON_STEPS):
            over = _brown_conrady(lens, flat) - places
            a, b, d = _brown_conrady_slopes(lens, flat)
            det = a * d - b * b
            step = np.stack(
                [d * over[..., 0] - b * over[..., 1], a * over[..., 1] - b * over[..., 0]], axis=-1
            )
            step = step / det[..., None]
            flat = flat - step
            if not (np.abs(step) > ROUNDING_RAD).any():
                break
        a, b, d = _brown_conrady_slopes(lens, flat)
        left = np.abs(_brown_conrady(lens, flat) - places).max(axis=-1)
        reached = np.hypot(flat[..., 0], flat[..., 1]) <= farthest * (1 + 1e-12)
        # A positive determinant: not beyond a fold that tangential terms make within the radial field.
        solved = np.isfinite(radius) & (left <= MAX_RESIDUAL * np.maximum(1.0, radius))
        seen = solved & reached & (a * d - b * b > 0)
        rays = np.concatenate([flat, np.ones((*flat.shape[:-1], 1))], axis=-1)
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    return np.where(seen[..., None], rays, np.nan)

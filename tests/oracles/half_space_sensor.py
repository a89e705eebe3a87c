"""A thick soft skin seen edge-on between crossed polarisers: the simplest photoelastic touch sensor.

The picture: x to the right, z down, the ray along y. Everything holds to first order in strain: the stress is
drawn where the skin was before it was pressed, the ray runs straight, the skin is larger than its field.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from numpy import ndarray
from tests.oracles.hertz_fringes import FringeTable, fringe_table, marched

from palpate.core.contact import Contact, Pose, Probe
from palpate.core.errors import InputError, RangeError
from palpate.core.frame import Frame
from palpate.core.shapes import Float, Float32
from palpate.mechanics.half_space import hertz
from palpate.optics.colour import Spectrum, assumed_camera, encode_srgb
from palpate.optics.image_chain import electrons, quantise, uneven_light
from palpate.optics.polariscope import with_leak
from palpate.optics.stress_optic import StressOpticLaw

LinearImage = Float[ndarray, "h w 3"]


@dataclass(frozen=True, slots=True)
class HalfSpaceSpec:
    """Every number of the sensor. All are assumed, of the order of real parts, and belong to no product.

    Attributes:
        youngs_modulus_pa: E of the skin [Pa]; 0.3 MPa is the middle of what Shore 15A silicones show.
        poisson_ratio: of the skin; the fringes are exact for 0.5 only, which is therefore required.
        ball_radius_m: R of the rigid ball [m].
        stress_optic: C of the skin; 3e-9 1/Pa is of the order of polyurethane, high enough for colours. Plain
            silicone is nearer to 2e-10 1/Pa and stays grey.
        width_px, height_px: of the image [px].
        pitch_m: of a pixel on the plane through the ball's centre [m].
        air_px: rows above the surface [px].
        polariser_rad: from x towards z [rad].
        extinction: crossed over parallel transmission of the polarisers.
        skin_transmission: share of the light that the skin lets pass.
        corner_loss: share of the lamp's light missing at half a diagonal from its centre.
        lamp_centre: where the light is strongest, in shares of the height and the width.
        holder_px: columns at each side that the skin's holder hides [px].
        lamp_gain: the lamp's light now over its light at set-up.
        bands: of wavelength, 400 to 700 nm.
        full_well_e: electrons at white [electrons].
        read_noise_e: of the camera [electrons].
        bits: of its converter.
        exposure_s: what the frame says of itself; already counted in `full_well_e` [s].
        depth_offset_m: how much deeper the ball is than the stage says [m].
        name: goes into each frame.
    """

    youngs_modulus_pa: float = 0.3e6
    poisson_ratio: float = 0.5
    ball_radius_m: float = 5e-3
    stress_optic: StressOpticLaw = field(default_factory=lambda: StressOpticLaw(3e-9))
    width_px: int = 160
    height_px: int = 96
    pitch_m: float = 0.125e-3
    air_px: int = 12
    polariser_rad: float = math.pi / 4
    extinction: float = 0.01
    skin_transmission: float = 0.8
    corner_loss: float = 0.6
    lamp_centre: tuple[float, float] = (0.45, 0.5)
    holder_px: int = 3
    lamp_gain: float = 1.0
    bands: int = 31
    full_well_e: float = 15_000.0
    read_noise_e: float = 5.0
    bits: int = 12
    exposure_s: float = 0.01
    depth_offset_m: float = 0.0
    name: str = "half-space"

    def __post_init__(self) -> None:
        if self.poisson_ratio != 0.5:
            raise RangeError(
                f"Poisson's ratio {self.poisson_ratio}: the fringes of this sensor are exact for an "
                "incompressible skin only; use 0.5"
            )
        if not (0 <= self.air_px < self.height_px and 0 <= 2 * self.holder_px < self.width_px):
            raise InputError(
                f"an image of {self.height_px} x {self.width_px} px with {self.air_px} px of air "
                f"and {self.holder_px} px of holder at each side shows no skin; give a larger image"
            )
        if not (self.pitch_m > 0 and self.full_well_e > 0 and self.read_noise_e >= 0 and self.lamp_gain >= 0):
            raise RangeError(
                f"pitch {self.pitch_m} m and full well {self.full_well_e} electrons must be positive, "
                f"read noise {self.read_noise_e} electrons and lamp gain {self.lamp_gain} not negative"
            )

    @property
    def x_m(self) -> Float[ndarray, " w"]:
        """Centres of the columns in the skin's frame [m]; 0 is the middle of the view."""
        return (np.arange(self.width_px) + 0.5 - self.width_px / 2) * self.pitch_m

    @property
    def z_m(self) -> Float[ndarray, " h"]:
        """Centres of the rows [m]; negative in the air, positive in the skin."""
        return (np.arange(self.height_px) + 0.5 - self.air_px) * self.pitch_m


def demo() -> HalfSpaceSpec:
    """160 x 96 px over 20 x 12 mm."""
    return HalfSpaceSpec()


def debug() -> HalfSpaceSpec:
    """The same view at a quarter of the pixels each way: for tests, and for finding faults."""
    return replace(
        demo(), width_px=40, height_px=24, air_px=3, holder_px=1, pitch_m=0.5e-3, name="half-space-debug"
    )


def press(spec: HalfSpaceSpec, pose: Pose) -> Contact:
    """Press the spec's ball into the spec's skin.

    Args:
        spec: the sensor; its `depth_offset_m` is added to a pose that touches.
        pose: what the stage says; depth 0 to about 1.25 mm for a 5 mm ball.

    Returns:
        The contact at the depth that was reached. Depth 0 means the ball is away, whatever the offset.

    Raises:
        RangeError: the depth lies outside Hertz's law.
    """
    depth_m = max(pose.depth_m + spec.depth_offset_m, 0.0) if pose.depth_m > 0 else pose.depth_m
    return hertz.press(
        Probe("sphere", spec.ball_radius_m),
        replace(pose, depth_m=depth_m),
        spec.youngs_modulus_pa,
        spec.poisson_ratio,
    )


def render(contact: Contact, spec: HalfSpaceSpec, rng: np.random.Generator) -> Frame:
    """The camera's frame of a contact.

    Args:
        contact: a sphere's; its y along the ray cannot be seen. The ball is in the picture only while it
            touches.
        spec: the sensor.
        rng: for the noise.

    Returns:
        8-bit sRGB ``[h w 3]``. Hundreds a second on one core after the first, which builds the table.

    Raises:
        RangeError: the contact is harder than any that the spec's skin and ball can make.
    """
    mean = render_clean(contact, spec) * np.float32(spec.full_well_e)
    codes = quantise(electrons(mean, spec.read_noise_e, rng), spec.full_well_e, spec.bits)
    return Frame(_srgb_of_codes(spec.bits)[codes], exposure_s=spec.exposure_s, sensor=spec.name)


def render_clean(contact: Contact, spec: HalfSpaceSpec) -> LinearImage:
    """What the camera would see without noise: linear RGB, 1 at the bare lamp's brightest at set-up."""
    light = np.zeros((spec.height_px, spec.width_px, 3), dtype=np.float32)
    if contact.radius_m > 0:
        light[spec.air_px :] = _fringes(contact, spec)
    return _through_parts(light, contact, spec)


def render_plain(contact: Contact, spec: HalfSpaceSpec, slices: int = 1024) -> LinearImage:
    """The slow reference for `render_clean`: every ray and band marched by itself, no table."""
    light = np.zeros((spec.height_px, spec.width_px, 3))
    if contact.radius_m > 0:
        x, z = np.meshgrid(*_in_radii(contact, spec))
        spectrum = _spectrum(spec.bands)
        for kappa, weight in zip(_kappa(contact, spec), spectrum.weight, strict=True):
            light[spec.air_px :] += weight * marched(x, z, kappa, spec.polariser_rad, slices)[..., None]
    return _through_parts(light, contact, spec)


def _fringes(contact: Contact, spec: HalfSpaceSpec) -> LinearImage:
    x, z = _in_radii(contact, spec)
    return _table(spec).image(x, z, _kappa(contact, spec), _spectrum(spec.bands).weight)


def _in_radii(contact: Contact, spec: HalfSpaceSpec) -> tuple[ndarray, ndarray]:
    a = contact.radius_m
    return (spec.x_m - contact.pose.x_m) / a, spec.z_m[spec.air_px :] / a


def _kappa(contact: Contact, spec: HalfSpaceSpec) -> Float[ndarray, " k"]:
    return _kappa_of(3 * contact.force_n / (2 * math.pi * contact.radius_m), spec)


def _kappa_of(p0_a: float, spec: HalfSpaceSpec) -> Float[ndarray, " k"]:
    wavelength = _spectrum(spec.bands).wavelength_m
    return np.asarray(spec.stress_optic.at(wavelength) * p0_a / wavelength)


def _table(spec: HalfSpaceSpec) -> FringeTable:
    deepest = hertz.greatest_depth(spec.ball_radius_m)
    p0 = hertz.peak_pressure(deepest, spec.ball_radius_m, spec.youngs_modulus_pa, spec.poisson_ratio)
    p0_a = p0 * hertz.contact_radius(deepest, spec.ball_radius_m)
    return fringe_table(spec.polariser_rad, float(_kappa_of(p0_a, spec).max()))


def _through_parts(light: LinearImage, contact: Contact, spec: HalfSpaceSpec) -> LinearImage:
    seen = with_leak(light, spec.extinction)
    seen *= _lamp(spec.height_px, spec.width_px, spec.corner_loss, spec.lamp_centre)[..., None]
    seen *= np.float32(spec.lamp_gain)
    seen[spec.air_px :] *= np.float32(spec.skin_transmission)
    if contact.radius_m > 0:
        seen[: spec.air_px][_behind_ball(contact, spec)] = 0.0
    seen[:, : spec.holder_px] = seen[:, spec.width_px - spec.holder_px :] = 0.0
    return seen


def _behind_ball(contact: Contact, spec: HalfSpaceSpec) -> ndarray:
    R, pose = contact.probe.radius_m, contact.pose
    x = spec.x_m - pose.x_m
    z = spec.z_m[: spec.air_px] - (pose.depth_m - R)
    return np.asarray(x**2 + z[:, None] ** 2 < R**2)


@lru_cache(maxsize=8)
def _spectrum(bands: int) -> Spectrum:
    return assumed_camera(bands)


@lru_cache(maxsize=8)
def _lamp(
    height: int, width: int, corner_loss: float, centre: tuple[float, float]
) -> Float32[ndarray, "h w"]:
    return uneven_light(height, width, corner_loss, centre)


@lru_cache(maxsize=4)
def _srgb_of_codes(bits: int) -> ndarray:
    return encode_srgb(np.arange(2**bits) / (2**bits - 1))

"""Presses of the virtual TacTip by the virtual rig's devices, with ground truth, written as a rig's files.

A press goes down at a steady speed onto a cylinder of stiffness kappa = E pi r^2 / h, flat or with a
spherical cap, a bonded layer, a viscous cylinder, or a rigid body; optionally it holds, or returns, with a
late camera. On an ideal rig the tip is where it is requested; a linear rig lags and yields
(`rig.virtual.linear_rig`).

What the words of a virtual TacTip's specimen mean: stiffness, modulus and radius, for files.
"""

from __future__ import annotations

import json
import math
import zlib
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from palpate.core import (
    RIGID,
    UNITS,
    Contact,
    Float,
    InputError,
    Int,
    ManualClock,
    Pose,
    PressHistory,
    Progress,
    RangeError,
    Seating,
    Specimen,
    UInt8,
    ndarray,
    new_file,
    new_folder,
    silent,
)
from palpate.core.provenance import Provenance
from palpate.recordings.exchange.image_import import import_press
from palpate.recordings.exchange.press_folder import (
    UNKNOWN_BODY,
    KnownBody,
    PressFolder,
    press_folder,
    write_press,
    write_specimens,
)
from palpate.recordings.exchange.press_table import press_rows
from palpate.rig.virtual.disturbances import Variation
from palpate.rig.virtual.linear_rig import LinearRig, rig_record
from palpate.rig.virtual.virtual_bench import CARRYING, ORIGIN_M
from palpate.rig.virtual.virtual_sensors import RANGE_N, VirtualForce
from palpate.rig.virtual.virtual_stage import VirtualStage
from palpate.rig.virtual.virtual_world import DrivenWorld, Touch, World
from palpate.sensors.tactip import TacTipSpec
from palpate.sensors.tactip.inclined_press import has_table
from palpate.sensors.tactip.tactip_press import TipOnSpecimen, ViscousPress, modulus_pa
from palpate.sensors.tactip.tactip_sensor import TacTip
from palpate.version import __version__


def stiffness_of(words: str) -> float:
    """Return the stiffness named by words: inf for a rigid plate, NaN for none of the whole top [N/m]."""
    stiffness_n_m = Specimen.parse(bare(words)).stiffness_n_m
    return math.nan if stiffness_n_m is None else stiffness_n_m


def shape_of(spec: TacTipSpec, words: str) -> KnownBody:
    """Return E / (1 - nu^2) and radius of curvature named by words: inf for rigid, NaN for layers and viscous
    bodies.
    """
    specimen = Specimen.parse(bare(words))
    if specimen.thickness_m is not None or specimen.branches:
        return UNKNOWN_BODY
    E = specimen.youngs_modulus_pa
    if E is None:
        assert specimen.stiffness_n_m is not None
        E = modulus_pa(spec.table, specimen.stiffness_n_m)
    return KnownBody(E / (1 - spec.table.poisson_ratio**2), specimen.radius_m)


def bare(words: str) -> str:
    """Return a specimen's words without its tilt."""
    return words.partition("@")[0]


def body_shown(spec: TacTipSpec, words: str) -> dict[str, Any]:
    """Return the description of a specimen for JSON."""
    specimen, known = Specimen.parse(bare(words)), shape_of(spec, words)
    shown: dict[str, Any] = {"stiffness_N_per_mm": stiffness_shown(stiffness_of(words))}
    if specimen.youngs_modulus_pa is None:
        return shown
    shown |= {
        "shape": specimen.shape,
        "youngs_modulus_MPa": shown_in("MPa", specimen.youngs_modulus_pa),
        "poisson_ratio": spec.table.poisson_ratio,
        "reduced_modulus_MPa": shown_in("MPa", known.modulus_pa),
        "radius_mm": shown_in("mm", specimen.radius_m),
    }
    if specimen.thickness_m is not None:
        shown["thickness_mm"] = shown_in("mm", specimen.thickness_m)
    if specimen.branches:
        shown["relaxation"] = [{"modulus_MPa": shown_in("MPa", E), "time_s": t} for E, t in specimen.branches]
    return shown


def stiffness_shown(stiffness_n_m: float) -> float | str | None:
    """Return a stiffness in N/mm for JSON."""
    return shown_in("N_per_mm", stiffness_n_m)


def shown_in(unit: str, value: float) -> float | str | None:
    """Return a value in a unit for JSON, which has no infinity and no NaN."""
    if math.isnan(value):
        return None
    return "inf" if math.isinf(value) else UNITS[unit].from_si(value)


# specimens of the compliance report
REPORT_N_M = {"rigid": math.inf, "S1": 7.6e3, "S2": 3.1e3, "S3": 1.1e3, "new": 5.3e3}
UNKNOWN = ("new",)  # specimen of unknown stiffness
LEAD_M = 1e-3  # above the specimen, where a press is at its speed
MAX_N = 5.2  # at whose first sample a press ends
TARE_S = 0.5
POLL_S = 0.1
MAX_HOLD_S = 60.0
TRUTH = "virtual.json"
LICENCE = "CC0-1.0"
ORIGIN = "rendered by palpate"


@dataclass(frozen=True)
class VirtualPress:
    """One press as the virtual rig's devices record it, with ground truth.

    Attributes:
        sensor, words: TacTip and specimen, such as "S1=7.6@30".
        time_s: of the force samples, from the first [s].
        raw_n: measured force less its reading in the air [N].
        position_m: encoder position of the stage, from the first sample [m].
        touches: contact state at every sample.
        frame_sample: sample index of every frame.
        desired_m: requested position, from the first sample [m].
        shown_sample: sample that every frame shows, if the camera is late; None for the same.
    """

    sensor: TacTip
    words: str
    seed: int
    time_s: Float[ndarray, " s"]
    raw_n: Float[ndarray, " s"]
    position_m: Float[ndarray, " s"]
    touches: tuple[Touch, ...]
    frame_sample: Int[ndarray, " f"]
    desired_m: Float[ndarray, " s"]
    shown_sample: Int[ndarray, " f"] | None = None

    @cached_property
    def true_force_n(self) -> Float[ndarray, " s"]:
        """Force without noise or steps [N]."""
        return np.array([touch.force_n[2] for touch in self.touches])

    @cached_property
    def true_approach_m(self) -> Float[ndarray, " s"]:
        """Depth below first touch [m]."""
        return np.array([touch.depth_m for touch in self.touches])

    @cached_property
    def true_area_m2(self) -> Float[ndarray, " s"]:
        """Area of the contact [m^2]."""
        if self.viscous:
            return np.array([math.pi * self._contact(i).radius_m ** 2 for i in range(len(self.touches))])
        return self.sensor.on(self.words).area_m2(self.true_force_n)

    @property
    def viscous(self) -> bool:
        specimen = self.sensor.specimen(self.words)
        return specimen is not None and bool(specimen.branches)

    @property
    def pose(self) -> Pose:
        return self._contact(self.deepest).pose

    @property
    def deepest(self) -> int:
        return int(np.argmax(self.true_approach_m))

    @property
    def seating(self) -> Seating:
        approach = self.touches[self.deepest].approach
        return Seating(approach.lamp_gain, approach.shift_px)

    def points_px(self, frame: int) -> tuple[Float[ndarray, "p 2"], Float[ndarray, " p"]]:
        """True centres (x, y) and radii of the markers in one frame, the middle pin first [px]."""
        return self.sensor.markers_px(self._contact(self._shown(frame)), self.seating)

    def frame(self, frame: int) -> UInt8[ndarray, "h w"]:
        rng = np.random.default_rng([self.seed, frame])
        return self.sensor.render(self._contact(self._shown(frame)), rng, self.seating).image

    def frames(self) -> Iterator[UInt8[ndarray, "h w"]]:
        return (self.frame(i) for i in range(len(self.frame_sample)))

    def _shown(self, frame: int) -> int:
        return int((self.frame_sample if self.shown_sample is None else self.shown_sample)[frame])

    def _contact(self, sample: int) -> Contact:
        touch, sensor = self.touches[sample], self.sensor
        pose = Pose(touch.x_m, touch.y_m, touch.depth_m)
        history = PressHistory(stiffening=touch.stiffening)
        return sensor.press(sensor.probe(self.words), pose, sensor.specimen(self.words), history)


def record_press(
    spec: TacTipSpec | TacTip,
    words: str,
    seed: int,
    rig: LinearRig | None = None,
    *,
    back: bool = False,
    late_s: float = 0.0,
    hold_s: float = 0.0,
) -> VirtualPress:
    """Press once, with random mounting misalignment, by the devices of the virtual rig on their own clock.

    Args:
        words: specimen, see `TacTip.probe`.
        rig: drives the tip; None for an ideal one.
        back: go to the depth of the greatest force and record the way back too; ideal rig only.
        late_s: by which frames show an earlier moment than their times state [s].
        hold_s: rest at the depth of the greatest force; ideal rig only [s].

    Raises:
        InputError: unknown specimen, a force rate that does not fit the rig's control, or a press that the
            rig or specimen excludes.
        RangeError: the greatest force is not reached, or `late_s` or `hold_s` is out of range.
    """
    sensor = spec if isinstance(spec, TacTip) else TacTip(spec)
    viscous = sensor.viscous(sensor.probe(words), sensor.specimen(words))
    _check_press(rig, late_s, hold_s, back=back, viscous=viscous is not None)
    spec, rate_hz = sensor.spec, sensor.spec.force.rate_hz
    world = _world(sensor, rig, seed)
    world.mount(words)
    stage, force = VirtualStage(world), VirtualForce(world, _range_n(rig))
    speed, run_up_m = spec.speed_m_s, spec.speed_m_s**2 / (2 * CARRYING.acceleration_m_s2)
    phase_m = np.random.default_rng(seed).uniform(0, speed / sensor.rate_hz)
    stage.move_to((0.0, 0.0, -(LEAD_M + phase_m + run_up_m)), CARRYING.top_speed_m_s)
    touches: list[Touch] = []
    _follow(world, touches, until_s=world.motion.ends_s)
    tare_s = world.now_s
    _follow(world, touches, until_s=tare_s + TARE_S)
    tip = sensor.on(words)
    behind_m = 0.0 if rig is None else rig.lag_m(speed, MAX_N)
    planned = back or hold_s > 0
    depth_m = tip.deepest_m + LEAD_M + behind_m
    if planned:
        depth_m = _depth_m(tip, MAX_N) if viscous is None else _ramp_depth_m(viscous, MAX_N, speed, rate_hz)
    stage.move_to((0.0, 0.0, depth_m), speed)
    motion = world.motion
    while stage.moving() and (planned or touches[-1].force_n[2] < MAX_N):
        _follow(world, touches, until_s=world.now_s + POLL_S)
    moves = [motion]
    if hold_s:
        _follow(world, touches, until_s=world.motion.ends_s + hold_s)
    if back:
        stage.move_to(motion.start_m, speed)
        moves.append(world.motion)
        _follow(world, touches, until_s=world.motion.ends_s + TARE_S)
    normal, time_s = np.array([t.force_n[2] for t in touches]), np.array([t.time_s for t in touches])
    if normal.max() < MAX_N and not planned:
        what = "the table ends" if rig is None else f"rig {rig.name!r} or the table ends"
        raise RangeError(f"{what} at {normal.max():.3g} N; a press goes to {MAX_N} N", code="force-range")
    world.clock.sleep(1.0)  # until the last sample has arrived
    samples = np.array([wrench.force_n[2] for wrench in force.drain()])[: len(touches)]
    end = len(normal) if planned else int(np.argmax(normal >= MAX_N)) + 1
    frame_sample = _nearest(sensor, time_s[:end])
    frame_sample = frame_sample[time_s[frame_sample] > motion.begun_s + speed / CARRYING.acceleration_m_s2]
    part = slice(int(frame_sample[0]), end)
    air = (time_s > tare_s) & (time_s < motion.begun_s)
    asked_m = moves[0].at(time_s[part])[:, 2]
    for move in moves[1:]:
        asked_m = np.where(time_s[part] < move.begun_s, asked_m, move.at(time_s[part])[:, 2])
    z_m = world.encoder_m(time_s[part]) if isinstance(world, DrivenWorld) else asked_m
    frame_sample = frame_sample - frame_sample[0]
    shown = frame_sample - round(late_s * rate_hz)
    inside = shown < len(z_m)
    return VirtualPress(
        sensor,
        words,
        seed,
        time_s[part] - time_s[part][0],
        samples[part] - samples[air].mean(),
        z_m - z_m[0],
        tuple(touches[part]),
        frame_sample[inside],
        asked_m - asked_m[0],
        np.maximum(shown[inside], 0) if late_s else None,
    )


def _check_press(rig: LinearRig | None, late_s: float, hold_s: float, *, back: bool, viscous: bool) -> None:
    """Refuse what neither rig nor specimen has been made for; see `record_press`."""
    if not math.isfinite(late_s):
        raise RangeError(f"frames late by {late_s} s; give a time, 0 for none")
    if not 0 <= hold_s <= MAX_HOLD_S:
        raise RangeError(f"a hold of {hold_s:g} s; 0 to {MAX_HOLD_S:g} s are allowed", code="hold")
    if (back or hold_s) and rig is not None:
        raise InputError(
            f"a press on the rig {rig.name!r} that comes back or holds; give that or the rig, not both"
        )
    if viscous and (back or rig is not None):
        raise InputError(
            "a viscous specimen is pressed on the way down, and held, by an ideal rig; the way back and the "
            "linear rig are of elastic ones"
        )


def _depth_m(tip: TipOnSpecimen, force_n: float) -> float:
    """Approach at which a contact has a force [m]."""
    approach_m = np.linspace(0.0, tip.deepest_m, 200)
    return float(np.interp(force_n, tip.force_n(approach_m), approach_m))


def _ramp_depth_m(viscous: ViscousPress, force_n: float, speed_m_s: float, rate_hz: float) -> float:
    """Depth at which a ramp from first touch has come to a force [m]."""
    press, depth_m = viscous.begun(), 0.0
    while press.force_n < force_n:
        depth_m += speed_m_s / rate_hz
        press.to(depth_m, 1 / rate_hz)
    return depth_m


def _world(sensor: TacTip, rig: LinearRig | None, seed: int) -> World:
    vary, rate_hz, clock = (
        replace(Variation(), **sensor.variation()),
        sensor.spec.force.rate_hz,
        ManualClock(),
    )
    if rig is None:
        return World(sensor, clock, CARRYING, ORIGIN_M, vary, rate_hz, seed, ())
    return DrivenWorld(rig, sensor, clock, CARRYING, ORIGIN_M, vary, rate_hz, seed)


def _range_n(rig: LinearRig | None) -> tuple[float, float, float]:
    """Range of the force sensor [N]."""
    if rig is None:
        return RANGE_N
    along, across = rig.cell_n
    return across, across, along


def _follow(world: World, touches: list[Touch], until_s: float) -> None:
    while world.now_s < until_s:
        world.clock.sleep(min(1.0, until_s - world.now_s + 1e-9))
        world.advance()
        last_s = touches[-1].time_s if touches else -math.inf
        touches.extend(touch for touch in world.touches if touch.time_s > last_s)


def _nearest(sensor: TacTip, time_s: Float[ndarray, " s"]) -> Int[ndarray, " f"]:
    ends_s = np.arange(1, math.floor(time_s[-1] * sensor.rate_hz) + 1) / sensor.rate_hz
    return np.searchsorted(time_s, ends_s - sensor.exposure_s / 2 + 1e-9, side="right") - 1


def specimens_at(
    spec: TacTipSpec,
    pressed: Mapping[str, float | str],
    tilt_rad: float = 0.0,
    *,
    progress: Progress = silent,
) -> dict[str, str]:
    """Solve the contacts with specimens: from finite-strain tables where there are, else by linear bodies.

    Tables are of upright presses and, without friction, of some inclined ones; see `at_finite_strain`. At 0
    degrees and 5.2 N, from 1.1 N/mm to rigid, linear bodies have 20 to 25 % less area than the tables of the
    tip "base", and -5 to 2 % of approach. To compare tilts by linear bodies, use a tilt such as 0.001 degrees
    for upright.

    Args:
        pressed: stiffness by name, inf for a rigid plate [N/m], or words such as "sphere:R_mm=20,E_MPa=0.3",
            see `Specimen.parse`.
        tilt_rad: of the specimens' tops, 0 to 50 degrees [rad].
        progress: called with how many are solved; linear bodies take some ten seconds each.

    Returns:
        The words by which the TacTip knows each specimen.
    """
    least, sensor = float(spec.table.specimen_pa[0]) / modulus_pa(spec.table, 1.0), TacTip(spec)
    for name, stiffness in pressed.items():
        if not isinstance(stiffness, str) and not stiffness >= least * (1 - 1e-9):
            raise RangeError(
                f"specimen {name} of {1e-3 * stiffness:g} N/mm; tip {spec.tip!r} has tables down to "
                f"{1e-3 * least:.3g} N/mm, up to inf for a rigid plate",
                code="stiffness-range",
            )
    held = [name for name, body in pressed.items() if tilt_rad and _tabulated(spec, body, tilt_rad)]
    if held and len(held) < len(pressed):
        raise RangeError(
            f"without friction {', '.join(held)} would be of a table at finite strain, the rest of linear "
            "bodies, which are not to be compared; press these alone, or give a friction above 0 for all",
            code="laws-mixed",
        )
    words: dict[str, str] = {}
    for name, body in pressed.items():
        face = f"specimen={body}" if isinstance(body, str) else _face(body)
        words[name] = f"{face}@{math.degrees(tilt_rad):.15g}" if tilt_rad else face
        sensor.on(words[name])
        progress("solving contacts", len(words), len(pressed))
    return words


def _face(stiffness_n_m: float) -> str:
    return RIGID if math.isinf(stiffness_n_m) else f"specimen={1e-3 * stiffness_n_m:.15g}"


def at_finite_strain(spec: TacTipSpec, pressed: Iterable[float | str], tilt_rad: float) -> TacTipSpec:
    """Return the sensor without friction, if then tables hold all of its inclined presses; else as it is.

    Args:
        pressed: stiffness, inf for a rigid plate [N/m], or words of another body.
        tilt_rad: of the tops [rad].
    """
    smooth = replace(spec, friction=0.0)
    return smooth if tilt_rad and all(_tabulated(smooth, one, tilt_rad) for one in pressed) else spec


def _tabulated(spec: TacTipSpec, body: float | str, tilt_rad: float) -> bool:
    return not isinstance(body, str) and has_table(spec, modulus_pa(spec.table, body), tilt_rad)


def record_trials(
    out: Path,
    spec: TacTipSpec,
    specimens: Mapping[str, str],
    trials: int = 5,
    *,
    seed: int = 0,
    unknown: Collection[str] = (),
    runs: bool = False,
    rig: LinearRig | None = None,
    back: bool = False,
    late_s: float = 0.0,
    hold_s: float = 0.0,
    progress: Progress = silent,
) -> PressFolder:
    """Press every specimen several times and write a rig's files, see `press_folder`; whole or not at all.

    `virtual.json` holds the ground truth. A specimen's presses depend on the seed, its name, and their
    numbers alone.

    Args:
        out: folder to make; must not exist.
        specimens: words of each, see `specimens_at`.
        trials: presses of each.
        unknown: names that `specimens.csv` does not describe.
        runs: also write each press as a run, in a folder of the press's name.
        rig, back, late_s, hold_s: see `record_press`.
    """
    if not (specimens and trials >= 1 and seed >= 0):
        raise InputError(
            f"{len(specimens)} specimens, {trials} trials, seed {seed}; at least 1, 1 and 0 are needed"
        )
    truths: dict[str, dict[str, Any]] = {name: {} for name in specimens}
    digits = max(2, len(str(trials)))
    with new_folder(out) as building:
        told = {name: words for name, words in specimens.items() if name not in unknown}
        stiffness = {n: stiffness_of(told[n]) if n in told else math.nan for n in specimens}
        bodies = {n: shape_of(spec, told[n]) if n in told else UNKNOWN_BODY for n in specimens}
        shaped = any(math.isfinite(Specimen.parse(bare(words)).radius_m) for words in specimens.values())
        write_specimens(building, stiffness, bodies if shaped else None)
        for i, (name, words) in enumerate(specimens.items()):
            for k in range(1, trials + 1):
                press = record_press(
                    spec, words, _seed(seed, name, k), rig, back=back, late_s=late_s, hold_s=hold_s
                )
                number = f"{k:0{digits}d}"
                _write(building / name, number, press, runs)
                truths[name][number] = _truth(press)
                progress("pressing", i * trials + k, len(specimens) * trials)
        with new_file(building / TRUTH) as path:
            about = _about(spec, specimens, seed, truths) | {"rig": rig_record(rig)}
            about |= {"late_ms": 1e3 * late_s} if late_s else {}
            about |= {"hold_s": hold_s} if hold_s else {}
            path.write_text(json.dumps(about, indent=1, allow_nan=False) + "\n")
    return press_folder(out)


def _seed(seed: int, name: str, number: int) -> int:
    return int(np.random.SeedSequence((seed, zlib.crc32(name.encode()), number)).generate_state(1)[0])


def _write(folder: Path, number: str, press: VirtualPress, runs: bool) -> None:
    places = (press.desired_m, press.position_m)
    rows = press_rows(press.time_s, press.raw_n, *places, press.frame_sample, press.true_area_m2)
    tiff, table = write_press(folder, number, press.frames(), rows)
    if runs:
        name = press.sensor.spec.name
        import_press(
            tiff,
            folder / number,
            force=table,
            sensor=name,
            licence=LICENCE,
            origin=ORIGIN,
            provenance=Provenance.SIMULATED,
        )


def _truth(press: VirtualPress) -> dict[str, Any]:
    down = press.deepest + 1
    return {
        "seed": press.seed,
        "touch_s": float(np.interp(0.0, press.true_approach_m[:down], press.time_s[:down])),
        "shift_px": list(press.seating.shift_px),
        "lean_deg": np.rad2deg(press.sensor.lean_rad(press.pose)).tolist(),
        "light_ratio": press.seating.light,
    }


def _about(
    spec: TacTipSpec, specimens: Mapping[str, str], seed: int, truths: Mapping[str, dict[str, Any]]
) -> dict[str, Any]:
    about, sensor = {}, TacTip(spec)
    for name, words in specimens.items():
        tilt_rad = sensor.probe(words).tilt_rad
        about[name] = body_shown(spec, words) | {
            "tilt_deg": math.degrees(tilt_rad),
            "model": sensor.on(words).law,
            "presses": truths[name],
        }
    return {
        "virtual": True,
        "origin": ORIGIN,
        "licence": LICENCE,
        "software": f"palpate {__version__}",
        "seed": seed,
        "spec": asdict(spec),
        "specimens": about,
    }

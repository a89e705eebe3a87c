"""Stage on a Marlin controller, such as a 3-D printer's, over a serial port. Tested on a fake only.

Every move is one `G1` in machine coordinates, one in flight at a time. The position comes from the step
counts (`Count` in M114), since M114 otherwise states the target.

A stop is M410, which acts at once only with an emergency parser (`latency_s`). It cuts the steps without
deceleration, so `top_speed_m_s` never exceeds the controller's jerk (M205) or what the spec states. An
emergency stop needs a switch of its own.

The volatile marker of a known position (`position_evidence`) is the extruder's logical position (G92), 0
after every start. M17 and M84 S0 keep the motors' current at rest until the next start.

Reference: marlinfw.org/docs/gcode: G28, G92, M17, M84, M114, M211, M410, M503.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from palpate.core import (
    NS_PER_S,
    Clock,
    DeviceError,
    InputError,
    Position,
    PositionUnknownError,
    RangeError,
    Travel,
)
from palpate.rig.real.gcode_spec import (
    MM_PER_M,
    GcodeSpec,
    Mount,
    distance_to_segment,
    feed_mm_min,
    fixed,
    shown,
)
from palpate.rig.real.gcode_stage import CutOffError, GcodeStage, SilenceError
from palpate.rig.real.marlin.marlin_link import Line, MarlinLink, MarlinMachine, Said, StepReport, Triple
from palpate.rig.real.position_evidence import (
    WHY,
    PositionEvidence,
    PositionFault,
    PositionStore,
    counted_by,
    new_marker,
    unknown,
)
from palpate.rig.real.serial_port import SerialPort

_HOW = "call home(), or reference() on your own word"
_WATCHED_S, _UNSEEN = 0.1, 3  # moves of this length without a place on the way, before that is a fault
_ASKS = 3  # for a place whose answer is damaged on its way


@dataclass(frozen=True, slots=True)
class MarlinSpec(GcodeSpec):
    """Specification of a Marlin stage.

    Attributes:
        sudden_m_s: fastest speed from which it can be stopped dead without losing steps; left out, the
            controller's jerk (M205). Try it, with the load that it carries [m/s]. `top_speed_m_s` never
            exceeds it.
        queued_s: more latency without an emergency parser, since M410 then waits for its turn [s].
    """

    boot_s: float = 5.0
    stop_s: float = 5.0
    home_s: float = 60.0
    sudden_m_s: float | None = None
    queued_s: float = 0.5


@dataclass(frozen=True, slots=True)
class MarlinMove:
    """A move in flight, in machine coordinates [mm]; where it was last seen at another place, and when."""

    start_mm: Triple
    target_mm: Triple
    speed_m_s: float
    last_mm: Triple
    last_ns: int


class MarlinStage(GcodeStage):
    """A `palpate.core.Stage`, see `GcodeStage`.

    Raises:
        DeviceError: no Marlin controller answers, or it cannot be driven: its message says why.
        RangeError: the spec states a speed that the machine cannot do.
        InputError: the spec lacks what the controller does not tell.
    """

    def __init__(self, spec: MarlinSpec, port: SerialPort, clock: Clock | None = None) -> None:
        super().__init__(spec, port, clock)
        self._mount = Mount(spec.axes)
        self._move: MarlinMove | None = None
        self._stood_mm: Triple | None = None
        self._lost = "its port was just opened, which may have reset it"
        self._homed = self._prompt = False
        self._stored = PositionStore(spec.port)
        self._unseen = 0
        self._link: MarlinLink = MarlinLink(port, spec.reply_s)
        try:
            self._machine = self._greet()
            self._speeds = self._known_speeds()
        except BaseException:
            self._link.close()
            raise

    @property
    def emergency_parser(self) -> bool:
        """Whether a stop is heeded as it arrives, as its firmware says."""
        return self._machine.emergency_parser

    @property
    def tells_jerk(self) -> bool:
        """Whether its firmware says from which speed it can stop dead (M205)."""
        return self._machine.jerk_mm_s is not None

    @property
    def travel(self) -> Travel:
        """The spec's limits, or the machine's own box; speed and latency as the module says."""
        machine, spec = self._machine, self._spec
        least, greatest = self._mount.box_m(*(machine.box_mm or ((0.0,) * 3, (0.0,) * 3)))
        return Travel(
            least_m=least if spec.least_m is None else spec.least_m,
            greatest_m=greatest if spec.greatest_m is None else spec.greatest_m,
            top_speed_m_s=min(self._speeds),
            acceleration_m_s2=min(machine.acceleration_mm_s2) / MM_PER_M,
            latency_s=spec.latency_s + (0.0 if machine.emergency_parser else spec.queued_s),
        )

    @property
    def steps_per_mm(self) -> tuple[float, float, float]:
        """Steps per millimeter of the machine's X, Y, and Z."""
        return self._machine.steps_per_mm

    def position_m(self) -> Position:
        with self._lock:
            self._need_known()
            place_mm = self._look()
            self._check_place(place_mm)
            return self._mount.sensor_m(place_mm)

    def _go(self, position_m: Position, speed_m_s: float, halts: int) -> None:
        self._need_known()
        self._need_standing("the stage is moving already; wait for it, or stop() it")
        start_mm = self._look()
        self._check_place(start_mm)
        self._send_move(start_mm, self._mount.machine_mm(position_m), speed_m_s, halts)

    def _go_by(self, by_m: float, speed_m_s: float, halts: int) -> None:
        self._need_standing("the stage is moving already; wait for it, or stop() it")
        self._note_restart()
        start_mm = self._look()
        x, y, z = self._mount.sensor_m(start_mm)
        self._send_move(start_mm, self._mount.machine_mm((x, y, z + by_m)), speed_m_s, halts)

    def _need_standing(self, why: str = "the stage is moving; stop() it first") -> None:
        if self._move:
            raise DeviceError(why)

    def unlock(self) -> None:
        """Refuse, since a Marlin controller that gave up (M112) only restarts.

        Raises:
            DeviceError: always.
        """
        raise DeviceError("a Marlin controller that gave up cannot be unlocked: switch it off and on again")

    def moving(self) -> bool:
        with self._lock:
            place_mm = self._look()
            self._check_place(place_mm)
            move = self._move
            if move is None:
                return False
            if self._arrived(place_mm, move.target_mm):
                self._settle(place_mm)
                self._check_prompt(move)
                return False
            now_ns = self._clock.now_ns()
            if place_mm != move.last_mm:
                self._move = replace(move, last_mm=place_mm, last_ns=now_ns)
            elif now_ns - move.last_ns > self._patience_ns(move):
                raise DeviceError(
                    f"the stage has stopped at {shown(place_mm)}, on its way to {shown(move.target_mm)} "
                    "(machine coordinates); stop() it, then see what blocks it, or its own limits (M211)"
                )
            return True

    def stop(self) -> None:
        """Stop dead at once; returns when it stands. See `palpate.core.Stage`.

        M410 goes out before anything is waited for, and calls in other threads that wait for an answer end
        with a `DeviceError`. It fails where the stage ran on further after it than `travel` states.
        """
        self._link.halt()
        with self._lock:
            if not self._link.restless:
                return
            self._bring_to_stand()

    def home(self) -> None:
        """Drive to the switches (G28) and take the machine's own coordinates from there; returns when done.

        A printer homes its Z towards the bed: whatever lies on it is in the way.

        Raises:
            DeviceError: it is moving, has no switches, did not find them, or was stopped.
        """
        halts = self._link.halts
        with self._lock:
            self._need_standing()
            self._note_restart()
            self._lose("homing was not finished")
            self._link.command("G28", timeout_s=self._spec.home_s, halts=halts, moves=True)
            _, place_mm = self._counted()
            self._mount, self._homed = self._mount.at_origin(), True
            self._regain(place_mm)

    def reference(self, position_m: Position) -> None:
        """Take the caller's word for where it stands, in the sensor's frame [m].

        Raises:
            RangeError: the position is not finite.
            InputError: the spec has no limits, and the machine's own do not hold unless it is homed.
            DeviceError: it does not stand.
        """
        if not all(math.isfinite(value) for value in position_m):
            raise RangeError(f"position {position_m} m must be finite")
        if self._spec.least_m is None:
            raise InputError(
                "give least_m and greatest_m [m]: the machine's own box holds only once it is homed",
                code="travel-missing",
            )
        with self._lock:
            self._note_restart()
            self._need_standing()
            _, place_mm = self._counted()
            self._mount = self._mount.placed(place_mm, position_m)
            self._regain(place_mm)

    def recall(self) -> None:
        """Take its place from the last session, where nothing can have moved or reset it since.

        See `palpate.rig.real.position_evidence`.
        """
        with self._lock:
            self._note_restart()
            place, place_mm = self._counted()
            evidence = PositionEvidence(
                self._motors_hold,
                round(place.extruder_mm or 0.0),
                self._settings,
                place_mm,
                self._machine.tolerance_mm,
            )
            try:
                stored = self._stored.recall(evidence)
            except PositionUnknownError as e:
                self._lost = WHY[PositionFault(e.code)]
                raise
            self._lost, self._mount = "", Mount(self._spec.axes, stored.origin_mm)
            self._settle(place_mm)

    def _greet(self) -> MarlinMachine:
        """Get into step with a controller that may be booting or moving, and ask what it is."""
        self._link.listen(self._spec.boot_s)
        for last in (False, False, True):
            try:
                self._link.begin()
                about = _texts(self._link.command("M115"))
                break
            except CutOffError:  # it boots only now
                if last:
                    raise
            except SilenceError as e:
                raise DeviceError(
                    f"nothing at {self._spec.port} answers as Marlin does (M118 and M115), "
                    f"{self._link.tail.in_words()}; check that this is the stage's port, power, cable, baud "
                    f"({self._spec.baud}), and whether the board needs dtr = true",
                    code="not-marlin",
                ) from e
        if not any("Marlin" in text for text in about):
            raise DeviceError(f"what answers at {self._spec.port} does not call itself Marlin: {about[:1]}")
        self._starts = self._link.starts
        self._set_modes()
        try:
            machine = MarlinMachine.read(
                _texts(self._link.command("M503")), _texts(self._link.command("M211")), about
            )
        except ValueError as e:
            raise DeviceError(f"the stage's controller cannot be driven: {e}") from e
        self._machine = machine
        self._calm()
        return machine

    def _calm(self) -> None:
        """Stop what is found moving, such as a print from its card."""
        first = self._ask().counts
        self._clock.sleep(max(self._spec.poll_s, 0.1))
        if self._ask().counts != first:
            self._link.restless = True
            self._link.halt()
            self._bring_to_stand()

    def _known_speeds(self) -> tuple[float, ...]:
        """Speeds that none may exceed [m/s]."""
        machine, spec = self._machine, self._spec
        if spec.least_m is None and machine.box_mm is None:
            raise InputError(
                "the stage's controller has no limits of its own (M211): give least_m and greatest_m"
            )
        if spec.sudden_m_s is None and machine.jerk_mm_s is None:
            raise InputError(
                "the stage's controller does not say from which speed it can stop dead (its M205 has no X, Y "
                "and Z): give sudden_m_s [m/s], and try it with the load that it carries",
                code="jerk-unknown",
            )
        sudden = spec.sudden_m_s or min(machine.jerk_mm_s or ()) / MM_PER_M
        fastest = min(machine.top_mm_s) / MM_PER_M
        if spec.top_speed_m_s is not None and spec.top_speed_m_s > min(fastest, sudden) * (1 + 1e-9):
            raise RangeError(
                f"a top speed of {spec.top_speed_m_s * MM_PER_M:g} mm/s is stated; the stage's slowest axis "
                f"does {fastest * MM_PER_M:g} mm/s (M203), and can stop dead from {sudden * MM_PER_M:g} "
                "mm/s; state the least of these or less"
            )
        return tuple(v for v in (sudden, fastest, spec.top_speed_m_s) if v)

    def _send_move(self, start_mm: Triple, target_mm: Triple, speed_m_s: float, halts: int) -> None:
        self._link.command("G90", halts=halts)
        self._stored.move(start_mm, target_mm)
        words = " ".join(f"{axis}{fixed(value)}" for axis, value in zip("XYZ", target_mm, strict=True))
        self._move = MarlinMove(start_mm, target_mm, speed_m_s, start_mm, self._clock.now_ns())
        line = f"G1 {words} F{fixed(feed_mm_min(speed_m_s), 3)}"
        try:
            said = self._link.command(line, halts=halts, moves=True)
        except CutOffError:
            if not self._link.restless:  # recalled before it was sent
                self._move = None
            raise
        except SilenceError:
            self._link.halt()
            self._bring_to_stand()  # it may have begun to move
            raise
        refused = [text for text in _texts(said) if "Unknown command" in text or "Home" in text]
        if refused:
            self._move = None
            raise DeviceError(f"the stage's controller refused to move: {refused[0]!r}", code="move-refused")

    def _ask(self) -> StepReport:
        """Ask for the place; an answer that was damaged is asked for again."""
        for _ in range(_ASKS):
            answer = self._link.command("M114")
            place = next((one for one in answer if isinstance(one, StepReport)), None)
            if place is not None:
                return place
        raise DeviceError("the stage does not say where it is (M114); if it moves, cut its power")

    def _check_prompt(self, move: MarlinMove) -> None:
        """Refuse a build that says where it is only once it has arrived: nobody could watch its moves."""
        took_s = math.dist(move.start_mm, move.target_mm) / (move.speed_m_s * MM_PER_M)
        self._unseen += not self._prompt and took_s > _WATCHED_S
        if self._unseen >= _UNSEEN:
            raise DeviceError(
                f"the stage told no place on its way in {_UNSEEN} moves: its build may answer M114 only when "
                "a move is over (M114_LEGACY), and cannot be guarded"
            )

    def _look(self) -> Triple:
        """Place now, by the steps counted [mm]."""
        self._check_restart()
        try:
            place = self._ask()
        except CutOffError:
            self._check_restart()  # the better reason
            raise
        self._check_restart()
        return self._machine.place_mm(place.counts)

    def _counted(self) -> tuple[StepReport, Triple]:
        """Place of a machine whose steps are its axes and whose coordinates are not shifted [mm]."""
        place = self._ask()
        place_mm = self._machine.place_mm(place.counts)
        if math.dist(place.planned_mm, place_mm) > self._machine.tolerance_mm + 0.01:  # it states 0.01 mm
            raise DeviceError(
                f"the stage states {shown(place.planned_mm)} and counts steps for {shown(place_mm)}: switch "
                "bed levelling off (M420 S0) and undo offsets (G92, M206), then open it anew",
                code="bed-leveling",
            )
        return place, place_mm

    def _check_place(self, place_mm: Triple) -> None:
        stray, within = "", self._machine.tolerance_mm
        if self._move:
            start, target = self._move.start_mm, self._move.target_mm
            off = distance_to_segment(place_mm, start, target)
            self._prompt = self._prompt or (place_mm != start and not self._arrived(place_mm, target))
            if off > within:
                stray = f"the stage counts {shown(place_mm)}, {off:.3f} mm off its way to {shown(target)}"
        elif self._stood_mm and math.dist(place_mm, self._stood_mm) > within:
            stray = f"the stage stood at {shown(self._stood_mm)} and is now at {shown(place_mm)}"
        if stray:
            self._lose("it was found where no move had sent it")
            raise DeviceError(f"{stray}; {_HOW}")

    def _arrived(self, place_mm: Triple, target_mm: Triple) -> bool:
        """Whether all steps of the move are made, but for the rounding to a step."""
        steps = self._machine.steps_per_mm
        return all(abs(a - b) * n <= 0.51 for a, b, n in zip(place_mm, target_mm, steps, strict=True))

    def _patience_ns(self, move: MarlinMove) -> float:
        """A creeping axis shows no change from one step to the next."""
        return max(self._spec.still_s, 5.0 * self._machine.step_mm / (move.speed_m_s * MM_PER_M)) * NS_PER_S

    def _bring_to_stand(self) -> None:
        """See it stand after a quickstop, and that it ran on no further than it may."""
        lost_before = self._lost
        asked_mm, stood_mm = self._await_stand()
        restarted = self._note_restart()
        if stood_mm is None:
            self._lose("it did not stop when told to")
            self._link.kill()
            raise DeviceError(
                "the stage did not stop when told to (M410) and was told to give up (M112): cut its power"
            )
        move = self._move
        if not self._lost:
            self._check_place(stood_mm)
        self._settle(stood_mm)
        if move and asked_mm:
            allowed_mm = self.travel.overshoot_m(move.speed_m_s) * MM_PER_M + self._machine.tolerance_mm
            went_mm = math.dist(asked_mm, stood_mm)
            if went_mm > allowed_mm:
                raise DeviceError(
                    f"the stage stands, but ran on {went_mm:.2f} mm after it was told to stop; "
                    f"{allowed_mm:.2f} mm are stated. Its stop does not work: use its switch"
                )
        if restarted or (self._lost and not lost_before):
            raise DeviceError(f"the stage stands, but its position was lost: {self._lost}; {_HOW}")

    def _await_stand(self) -> tuple[Triple | None, Triple | None]:
        """Places at the first answer after the stop, and where it stands; None where it does not [mm]."""
        began_ns, first, previous = self._clock.now_ns(), None, None
        while self._clock.now_ns() - began_ns < self._spec.stop_s * NS_PER_S:
            try:
                place = self._link.command("M114")
            except CutOffError:
                self._note_restart()
                continue
            except SilenceError:
                break
            now = next((one for one in place if isinstance(one, StepReport)), None)
            if now is not None:
                if now.counts == previous:
                    return first, self._machine.place_mm(now.counts)
                first, previous = first or self._machine.place_mm(now.counts), now.counts
            self._clock.sleep(self._spec.poll_s)
        return first, None

    def _settle(self, place_mm: Triple) -> None:
        self._move, self._stood_mm = None, place_mm
        self._link.restless = False
        self._stored.stand(place_mm)

    def _regain(self, place_mm: Triple) -> None:
        """Take its place as known, store it, and mark the controller."""
        self._settle(place_mm)
        self._lost, marker = "", new_marker()
        self._stored.establish(marker, self._settings, self._mount.origin_mm, place_mm)
        self._link.command(f"G92 E{marker}")

    @property
    def _settings(self) -> str:
        return counted_by(self._spec.axes, self._machine.steps_per_mm, self._spec.frame)

    def _lose(self, why: str) -> None:
        self._lost, self._stood_mm = why, None
        self._stored.forget()

    def _note_restart(self) -> bool:
        """Take note of a restart that nobody asked for, and number lines anew; whether there was one."""
        if self._link.starts == self._starts:
            return False
        self._starts, self._move, self._homed = self._link.starts, None, False
        self._link.begin()
        self._lose("its controller restarted by itself")
        self._starts = self._link.starts  # what came meanwhile was of the same one
        self._set_modes()
        return True

    def _set_modes(self) -> None:
        for line in ("G21", "G90", "M220 S100"):  # millimeters; absolute; speeds as sent
            self._link.command(line)
        said = [text for line in ("M17", "M84 S0") for text in _texts(self._link.command(line))]
        self._motors_hold = not any("Unknown command" in text for text in said)

    def _check_restart(self) -> None:
        if self._note_restart():
            raise DeviceError(f"the stage's controller restarted by itself; check its supply, then {_HOW}")

    def _need_known(self) -> None:
        if self._link.dead:
            raise DeviceError(self._link.dead)
        self._check_restart()
        if self._lost:
            raise unknown(self._lost, self._stored.lost)


def _texts(said: tuple[Line, ...]) -> list[str]:
    return [one.text for one in said if isinstance(one, Said)]

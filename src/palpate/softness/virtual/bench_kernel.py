"""The compiled steps of a rendering bench: finger, tip, arm and gas, one small step of time after another.

    m_t (a'' + s'') = F - P          tip under the finger's pulp F and the display's force P
    m_a a''         = P - F_a - ...  arm that carries the display
    m_f f''         = k (x - f) + c (x' - f') - F      finger, held where it is meant to be, x
    P = p A(s) + k_s s + c_s s' + friction             gauge pressure p
    p' = n / V (R T q + (p + p0) A s')                 V' = -A s'

With a plate in the display's place the tip does not move against the arm.

q is the mass flow of ISO 6358, through the valve, whose opening arrives later by the tube's lag, and past the
cylinders.
Semi-implicit Euler; friction is Coulomb's, smoothed over a speed of `creep` at which it turns round.
"""

import math
from typing import NamedTuple, no_type_check

import numba

CREEP = 2e-4  # least speed over which Coulomb friction turns round [m/s]
WALL_N_M, WALL_N_S_M = 2e4, 10.0  # of the stops at both ends of the tip's way
LINEAR_RATIO = 0.98  # of pressures above which a flow is taken as laminar, so that it ends smoothly

ARM, ARM_SPEED, PUSH, PUSH_SPEED, FINGER, FINGER_SPEED = range(6)
PRESSURE, SPOOL, SPOOL_SPEED, OPENING, ARM_FORCE, SAFE = range(6, 12)
STATES = 12


class BenchFigures(NamedTuple):
    """Figures of all parts, as the steps take them; see `display_parts` for units."""

    height: float
    dead: float
    polytropic: float
    gas: float
    density: float
    air: float
    supply: float
    conductance: float
    ratio: float
    overlap: float
    spool_omega: float
    tube_lag: float
    leak: float
    safety: float
    safety_lag: float
    sleeve: float
    tip_friction: float
    tip_damping: float
    tip: float
    arm: float
    arm_friction: float
    arm_damping: float
    arm_lag: float
    arm_reach: float
    finger: float
    muscle: float
    muscle_damping: float
    pulp: float
    pulp_rate: float
    pulp_damping: float
    plate: float
    safe: float
    tip_creep: float
    arm_creep: float


def creep(friction: float, mass: float, dt: float) -> float:
    """Return the smoothing speed [m/s] of a Coulomb friction, stable for explicit steps of `dt` (dt f / (v m)
    <= 1.25).
    """
    return max(CREEP, 0.8 * dt * friction / mass)


@numba.njit(cache=True)
@no_type_check
def mass_flow(conductance, density, upstream, downstream, b):
    """ISO 6358's mass flow from absolute pressures [kg/s]; 0 against the fall of pressure."""
    if downstream >= upstream:
        return 0.0
    r = downstream / upstream
    full = conductance * density * upstream
    if r <= b:
        return full
    if r < LINEAR_RATIO:
        return full * math.sqrt(1.0 - ((r - b) / (1.0 - b)) ** 2)
    edge = math.sqrt(1.0 - ((LINEAR_RATIO - b) / (1.0 - b)) ** 2)
    return full * edge * (1.0 - r) / (1.0 - LINEAR_RATIO)


@numba.njit(cache=True)
@no_type_check
def valve_flow(opening, pressure, par):
    """Mass flow into the chamber at an opening of -1, exhaust, to 1, supply [kg/s]."""
    gap = abs(opening) - par.overlap
    if gap <= 0.0:
        return 0.0
    conductance = par.conductance * min(gap / (1.0 - par.overlap), 1.0)
    if opening > 0.0:
        return mass_flow(conductance, par.density, par.supply + par.air, pressure, par.ratio)
    return -mass_flow(conductance, par.density, pressure, par.air, par.ratio)


@numba.njit(cache=True)
@no_type_check
def _at(push, height, table):
    place = min(max(push / height, 0.0), 1.0) * (table.size - 1)
    i = min(int(place), table.size - 2)
    return table[i] + (place - i) * (table[i + 1] - table[i])


@numba.njit(cache=True)
@no_type_check
def pulp_force(state, par):
    """Force of the finger's pulp on the tip [N]."""
    depth = state[FINGER] - state[ARM] - state[PUSH]
    if depth <= 0.0:
        return 0.0
    speed = state[FINGER_SPEED] - state[ARM_SPEED] - state[PUSH_SPEED]
    elastic = par.pulp * (math.exp(min(par.pulp_rate * depth, 12.0)) - 1.0)
    return max(elastic + par.pulp_damping * speed, 0.0)


@numba.njit(cache=True)
@no_type_check
def display_force(state, par, areas):
    """Force of the display on the finger, and on the arm [N]."""
    push, speed = state[PUSH], state[PUSH_SPEED]
    force = (state[PRESSURE] - par.air) * _at(push, par.height, areas) + par.sleeve * max(push, 0.0)
    force += par.tip_damping * speed + par.tip_friction * math.tanh(speed / par.tip_creep)
    if push < 0.0:
        force += WALL_N_M * push + WALL_N_S_M * speed
    elif push > par.height:
        force += WALL_N_M * (push - par.height) + WALL_N_S_M * speed
    return force


@numba.njit(cache=True)
@no_type_check
def advance(state, par, areas, volumes, meant, meant_speed, opening, force, dt):
    """Advance `state` (SI, absolute pressure) in place, one step per element of `meant`.

    Returns:
        Work of the finger on the display [J], and the greatest pulp force [N].
    """
    work, largest = 0.0, 0.0
    for k in range(meant.size):
        accel = par.spool_omega**2 * (opening - state[SPOOL]) - 2 * 0.8 * par.spool_omega * state[SPOOL_SPEED]
        state[SPOOL_SPEED] += accel * dt
        state[SPOOL] += state[SPOOL_SPEED] * dt
        state[OPENING] += (min(max(state[SPOOL], -1.0), 1.0) - state[OPENING]) * min(dt / par.tube_lag, 1.0)
        state[SAFE] += min(max(par.safe - state[SAFE], -dt / par.safety_lag), dt / par.safety_lag)
        if state[SAFE] < 1.0:
            through = valve_flow(state[OPENING], state[PRESSURE], par)
        else:
            through = -mass_flow(par.safety, par.density, state[PRESSURE], par.air, par.ratio)
        lost = mass_flow(par.leak, par.density, state[PRESSURE], par.air, par.ratio)
        area = _at(state[PUSH], par.height, areas)
        volume = par.dead + _at(state[PUSH], par.height, volumes)
        push_speed = state[PUSH_SPEED] if 0.0 <= state[PUSH] <= par.height else 0.0
        rise = par.gas * (through - lost) + state[PRESSURE] * area * push_speed
        state[PRESSURE] = max(state[PRESSURE] + par.polytropic / volume * rise * dt, 0.5 * par.air)

        state[ARM_FORCE] += (force - state[ARM_FORCE]) * min(dt / max(par.arm_lag, dt), 1.0)
        pulp, back = pulp_force(state, par), display_force(state, par, areas)
        speed = state[ARM_SPEED]
        push_back = par.arm_damping * speed + par.arm_friction * math.tanh(speed / par.arm_creep)
        if state[ARM] > par.arm_reach:
            push_back += WALL_N_M * (state[ARM] - par.arm_reach) + WALL_N_S_M * speed
        elif state[ARM] < -par.arm_reach:
            push_back += WALL_N_M * (state[ARM] + par.arm_reach) + WALL_N_S_M * speed
        if par.plate > 0.0:
            arm_accel, push_accel = (pulp - state[ARM_FORCE] - push_back) / (par.arm + par.tip), 0.0
        else:
            arm_accel = (back - state[ARM_FORCE] - push_back) / par.arm
            push_accel = (pulp - back) / par.tip - arm_accel
        state[ARM_SPEED] += arm_accel * dt
        state[PUSH_SPEED] += push_accel * dt
        lag = meant[k] - state[FINGER]
        pull = par.muscle * lag + par.muscle_damping * (meant_speed[k] - state[FINGER_SPEED])
        state[FINGER_SPEED] += (pull - pulp) / par.finger * dt
        state[ARM] += state[ARM_SPEED] * dt
        state[PUSH] += state[PUSH_SPEED] * dt
        state[FINGER] += state[FINGER_SPEED] * dt
        work += pulp * (state[ARM_SPEED] + state[PUSH_SPEED]) * dt
        largest = max(largest, pulp)
    return work, largest

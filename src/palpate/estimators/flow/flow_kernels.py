"""Compiled loops of the Horn and Schunck flow.

Sweeps run as a wavefront: sweep k + 1 does row r once sweep k has done row r + 1, so that all live rows stay
in cache; the result equals whole sweeps exactly. A row of w pixels occupies `row_length(w)` numbers: pixels,
the last one again, and padding. Sixteen-number vectors are written out because plain Numba takes 2.3 times as
long. Nothing checks bounds. Kernels release the GIL.
"""

from __future__ import annotations

import operator
from typing import no_type_check

import numba
import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic, models, overload, register_model

WIDTH = 16
_VECTOR = ir.VectorType(ir.FloatType(), WIDTH)
_INDEX = ir.IntType(32)
_MAY = ("contract", "nsz")  # a product and a sum in one rounding; zero has no sign


class Lanes(types.Type):
    """Sixteen numbers of single precision as a Numba type."""

    def __init__(self) -> None:
        super().__init__(name="Lanes")


LANES = Lanes()


@register_model(Lanes)
class _Model(models.PrimitiveModel):
    @no_type_check
    def __init__(self, manager, kind):
        super().__init__(manager, kind, _VECTOR)


@no_type_check
def _place(context, builder, kind, array, at):
    data = context.make_array(kind)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [at]), _VECTOR.as_pointer())


@intrinsic
@no_type_check
def load(typing, array, at):
    """Load sixteen numbers from an index."""

    def generate(context, builder, signature, given):
        lanes = builder.load(_place(context, builder, array, *given))
        lanes.align = 4
        return lanes

    return LANES(array, types.intp), generate


@intrinsic
@no_type_check
def store(typing, array, at, lanes):
    """Store sixteen numbers at an index."""

    def generate(context, builder, signature, given):
        builder.store(given[2], _place(context, builder, array, *given[:2])).align = 4
        return context.get_dummy_value()

    return types.void(array, types.intp, LANES), generate


@intrinsic
@no_type_check
def all_of(typing, number):
    """Repeat one number sixteen times."""

    def generate(context, builder, signature, given):
        none = ir.Constant(_VECTOR, ir.Undefined)
        first = builder.insert_element(none, given[0], _INDEX(0))
        return builder.shuffle_vector(first, none, _pick([0] * WIDTH))

    return LANES(types.float32), generate


@intrinsic
@no_type_check
def first_of(typing, lanes):
    """Repeat the first of sixteen."""

    def generate(context, builder, signature, given):
        return builder.shuffle_vector(given[0], given[0], _pick([0] * WIDTH))

    return LANES(LANES), generate


@intrinsic
@no_type_check
def root(typing, lanes):
    """Return the square roots."""

    def generate(context, builder, signature, given):
        kind = ir.FunctionType(_VECTOR, [_VECTOR])
        function = builder.module.declare_intrinsic(f"llvm.sqrt.v{WIDTH}f32", (), kind)
        return builder.call(function, given)

    return LANES(LANES), generate


@no_type_check
def _pick(places):
    return ir.Constant(ir.VectorType(_INDEX, WIDTH), list(places))


@no_type_check
def _of_two(method, **options):
    @intrinsic
    def function(typing, a, b):
        def generate(context, builder, signature, given):
            return getattr(builder, method)(*given, **options)

        return LANES(LANES, LANES), generate

    return function


# left neighbors, from two consecutive vectors
left_of = _of_two("shuffle_vector", mask=_pick(range(WIDTH - 1, 2 * WIDTH - 1)))
# right neighbors, from two consecutive vectors
right_of = _of_two("shuffle_vector", mask=_pick(range(1, WIDTH + 1)))

_ARITHMETIC = {operator.add: "fadd", operator.sub: "fsub", operator.mul: "fmul", operator.truediv: "fdiv"}


@no_type_check
def _overload(operation, method):
    lanes = _of_two(method, flags=_MAY)

    @overload(operation)
    def choose(a, b):
        if isinstance(a, Lanes) and isinstance(b, Lanes):
            return lambda a, b: lanes(a, b)
        return None


for _operation, _method in _ARITHMETIC.items():
    _overload(_operation, _method)


f32 = np.float32
ONE, TWO, TWELFTH = f32(1), f32(2), f32(1 / 12)
STEP = 4  # rows of a front, the fastest of 1 to 8 with a first cache of 48 KiB
RING = STEP + 2  # rows of a sweep that are alive: those of a front, one above and one below
FAST = {"nogil": True, "fastmath": {"contract", "nsz"}, "error_model": "numpy", "cache": True}


@numba.njit(**FAST)
@no_type_check
def row_length(w):
    """Return the numbers in a row of w pixels."""
    return (w // WIDTH + 2) * WIDTH


@numba.njit(**FAST)
@no_type_check
def coefficients(a, b, w, quarter, alpha2, e):
    """Fill e [h 3 row] with E_x, E_y, E_t over sqrt(alpha^2 + E_x^2 + E_y^2)."""
    h, row = a.shape
    a, b, e = a.reshape(a.size), b.reshape(b.size), e.reshape(e.size)
    one, quarter, alpha2 = all_of(ONE), all_of(quarter), all_of(alpha2)
    for r in range(h):
        for c in range(0, w, WIDTH):
            i, j, to = r * row + c, min(r + 1, h - 1) * row + c, 3 * r * row + c
            a00, a01, a10, a11 = load(a, i), load(a, i + 1), load(a, j), load(a, j + 1)
            b00, b01, b10, b11 = load(b, i), load(b, i + 1), load(b, j), load(b, j + 1)
            x = (a01 - a00 + a11 - a10 + b01 - b00 + b11 - b10) * quarter
            y = (a10 - a00 + a11 - a01 + b10 - b00 + b11 - b01) * quarter
            t = (b00 - a00 + b01 - a01 + b10 - a10 + b11 - a11) * quarter
            weight = one / root(alpha2 + x * x + y * y)
            store(e, to, x * weight)
            store(e, to + row, y * weight)
            store(e, to + 2 * row, t * weight)


@numba.njit(**FAST)
@no_type_check
def _sweep(flow, u0, u1, u2, to, e, at, w):
    """One row of one sweep, from three rows of the last sweep; v lies a row after u."""
    row = row_length(w)
    v0, v1, v2 = u0 + row, u1 + row, u2 + row
    two, twelfth = all_of(TWO), all_of(TWELFTH)
    ou, ov = load(flow, u0) + load(flow, u2), load(flow, v0) + load(flow, v2)
    su, sv = ou + two * load(flow, u1), ov + two * load(flow, v1)
    su_left, sv_left = first_of(su), first_of(sv)  # beyond the border the flow repeats
    for c in range(0, w, WIDTH):
        d = c + WIDTH
        ou_right, ov_right = load(flow, u0 + d) + load(flow, u2 + d), load(flow, v0 + d) + load(flow, v2 + d)
        su_right, sv_right = ou_right + two * load(flow, u1 + d), ov_right + two * load(flow, v1 + d)
        p = (left_of(su_left, su) + right_of(su, su_right) + two * ou) * twelfth
        q = (left_of(sv_left, sv) + right_of(sv, sv_right) + two * ov) * twelfth
        x, y, t = load(e, at + c), load(e, at + row + c), load(e, at + 2 * row + c)
        off = x * p + y * q + t
        store(flow, to + c, p - x * off)
        store(flow, to + row + c, q - y * off)
        su_left, su, ou = su, su_right, ou_right
        sv_left, sv, ov = sv, sv_right, ov_right
    flow[to + w], flow[to + row + w] = flow[to + w - 1], flow[to + row + w - 1]


@numba.njit(**FAST)
@no_type_check
def _copy(a, i, b, j, w):
    """Copy w numbers from place i of a to place j of b."""
    whole = w // WIDTH * WIDTH
    for c in range(0, whole, WIDTH):
        store(b, j + c, load(a, i + c))
    for c in range(whole, w):
        b[j + c] = a[i + c]


@numba.njit(**FAST)
@no_type_check
def _row(k, r, w):
    return (k * RING + r % RING) * 2 * row_length(w)


@numba.njit(**FAST)
@no_type_check
def relax(e, n, rows, flow):
    """Run n sweeps from the flow [2 h w], in place, in the workspace `rows` [n+1 RING 2 row]."""
    h, w = flow.shape[1:]
    v, row = h * w, row_length(w)
    e, rows, flow = e.reshape(e.size), rows.reshape(rows.size), flow.reshape(flow.size)
    for front in range(0, h + n, STEP):
        for r in range(front, min(front + STEP, h)):  # sweep 0 is where the flow starts
            to = _row(0, r, w)
            _copy(flow, r * w, rows, to, w)
            _copy(flow, v + r * w, rows, to + row, w)
            rows[to + w], rows[to + row + w] = rows[to + w - 1], rows[to + row + w - 1]
        for k in range(1, n + 1):
            for r in range(max(0, front - k), min(front - k + STEP, h)):
                above, here, below = max(r - 1, 0), r, min(r + 1, h - 1)
                u0, u1, u2 = _row(k - 1, above, w), _row(k - 1, here, w), _row(k - 1, below, w)
                _sweep(rows, u0, u1, u2, _row(k, r, w), e, 3 * r * row, w)
        for r in range(max(0, front - n), min(front - n + STEP, h)):
            last = _row(n, r, w)
            _copy(rows, last, flow, r * w, w)
            _copy(rows, last + row, flow, v + r * w, w)


@numba.njit(**FAST)
@no_type_check
def diverge(flow, out):
    """Fill out [h w] with du/dx + dv/dy of the flow [2 h w]; central differences, one-sided on the border."""
    u, v = flow[0], flow[1]
    h, w = out.shape
    half = f32(0.5)
    for r in range(h):
        up, down = max(r - 1, 0), min(r + 1, h - 1)
        per_row = half if down - up == 2 else f32(1)
        for c in range(1, w - 1):
            out[r, c] = half * (u[r, c + 1] - u[r, c - 1]) + per_row * (v[down, c] - v[up, c])
        out[r, 0] = u[r, 1] - u[r, 0] + per_row * (v[down, 0] - v[up, 0])
        out[r, w - 1] = u[r, w - 1] - u[r, w - 2] + per_row * (v[down, w - 1] - v[up, w - 1])

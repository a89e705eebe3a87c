"""Sixteen numbers of single precision as one value in compiled code, with +, -, * and /.

Plain Numba is slower: the same wavefront with plain loops over rows takes 2.3 times as long (whole sweeps
take 2.7 times; medians of 15 rounds in turns, one thread, on the frames of `benchmarks/estimators/flow.py`).
LLVM turns a plain loop into vectors only after proving that no array overlaps another, which it gives up for
as many arrays as a sweep of flow reads. With the vector written out nothing has to be proved, and a number
loaded for one place stays in a register for the next. Narrower registers take two or four of them; the
numbers are the same.

Arrays are flat and of float32; a place is where the first of sixteen lies. Nothing checks bounds. Numba's
cache of compiled code looks at the file of the function it keeps only: after a change here, touch
`flow_kernels`.
"""

from __future__ import annotations

import operator
from typing import no_type_check

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic, models, overload, register_model

WIDTH = 16
_VECTOR = ir.VectorType(ir.FloatType(), WIDTH)
_INDEX = ir.IntType(32)
_MAY = ("contract", "nsz")  # a product and a sum in one rounding; zero has no sign


class Lanes(types.Type):
    """The type, to Numba."""

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
    """Sixteen from a place on."""

    def generate(context, builder, signature, given):
        lanes = builder.load(_place(context, builder, array, *given))
        lanes.align = 4
        return lanes

    return LANES(array, types.intp), generate


@intrinsic
@no_type_check
def store(typing, array, at, lanes):
    """Write sixteen to a place and on."""

    def generate(context, builder, signature, given):
        builder.store(given[2], _place(context, builder, array, *given[:2])).align = 4
        return context.get_dummy_value()

    return types.void(array, types.intp, LANES), generate


@intrinsic
@no_type_check
def all_of(typing, number):
    """One number sixteen times."""

    def generate(context, builder, signature, given):
        none = ir.Constant(_VECTOR, ir.Undefined)
        first = builder.insert_element(none, given[0], _INDEX(0))
        return builder.shuffle_vector(first, none, _pick([0] * WIDTH))

    return LANES(types.float32), generate


@intrinsic
@no_type_check
def first_of(typing, lanes):
    """The first of sixteen, sixteen times."""

    def generate(context, builder, signature, given):
        return builder.shuffle_vector(given[0], given[0], _pick([0] * WIDTH))

    return LANES(LANES), generate


@intrinsic
@no_type_check
def root(typing, lanes):
    """Square roots."""

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


left_of = _of_two("shuffle_vector", mask=_pick(range(WIDTH - 1, 2 * WIDTH - 1)))
"""Of two that follow each other, the neighbours one to the left of the second's places."""
right_of = _of_two("shuffle_vector", mask=_pick(range(1, WIDTH + 1)))
"""Of two that follow each other, the neighbours one to the right of the first's places."""

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

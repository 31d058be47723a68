"""Vectors as values of compiled code: what C compilers offer as vector extensions.

LLVM's own vectoriser stops at 256 bits, tests for aliasing before every loop, and says nothing
when it gives up. Here a kernel names its vectors: ``load`` makes one, ``+ - * /``, comparisons,
``min``, ``max``, ``abs`` and ``math.sqrt`` work lane by lane and take scalars, and LLVM cuts all
that to whatever registers the machine has. Only ``fma`` fuses, and only where the machine can.
"""

# mypy: disable-error-code="no-untyped-call"
# numba's and LLVM's builders have no types.

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Any, cast

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba.core import cgutils, types
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, lower_cast, models, register_model

from tsplat.backends.numba_kernels.jit import kernel

# What it makes is called without the first argument, which no type checker knows.
_intrinsic = cast("Callable[..., Callable[..., Any]]", intrinsic)


class Vector(types.Type):
    """``lanes`` numbers or booleans of type ``dtype``."""

    def __init__(self, dtype: Any, lanes: int) -> None:
        super().__init__(f"Vector({dtype}, {lanes})")
        self.dtype, self.lanes = dtype, lanes

    def of(self, dtype: Any) -> Vector:
        """As many lanes of another type."""
        return Vector(dtype, self.lanes)

    @property
    def llvm(self) -> ir.VectorType:
        """The type in LLVM; booleans are one bit."""
        names = {types.float32: ir.FloatType(), types.float64: ir.DoubleType()}
        element = names.get(self.dtype) or ir.IntType(getattr(self.dtype, "bitwidth", 1))
        return ir.VectorType(element, self.lanes)


@register_model(Vector)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Vector) -> None:
        super().__init__(manager, kind, kind.llvm)


@lower_cast(types.Number, Vector)  # type: ignore[untyped-decorator]
def _broadcast(context: Any, builder: Any, source: Any, target: Vector, value: Any) -> Any:
    """The same number in every lane."""
    scalar = context.cast(builder, value, source, target.dtype)
    one = builder.insert_element(ir.Constant(target.llvm, ir.Undefined), scalar, _int(0))
    return builder.shuffle_vector(one, one, _lanes([0] * target.lanes))


def _int(value: int) -> ir.Constant:
    return ir.Constant(ir.IntType(32), value)


def _lanes(numbers: list[int]) -> ir.Constant:
    return ir.Constant(ir.VectorType(ir.IntType(32), len(numbers)), numbers)


def _call(builder: Any, name: str, kind: Vector, args: Any) -> Any:
    """Calls LLVM's intrinsic ``name`` on vectors of floats."""
    name = f"llvm.{name}.v{kind.lanes}f{kind.dtype.bitwidth}"
    declared = ir.FunctionType(kind.llvm, [kind.llvm] * len(args))
    return builder.call(cgutils.get_or_insert_function(builder.module, declared, name), args)


def _operator(function: Any, lower: Callable[..., Any], truth: bool = False, of: int = 2) -> None:
    """Teaches ``function`` to take ``of`` vectors, or vectors and numbers."""

    class Template(AbstractTemplate):
        def generic(self, args: tuple[Any, ...], kws: Any) -> Any:
            vector = next((a for a in args if isinstance(a, Vector)), None)
            if vector is None or len(args) != of:
                return None
            return signature(vector.of(types.boolean) if truth else vector, *[vector] * of)

    infer_global(function)(Template)

    def implementation(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return lower(builder, sig.args[0], *args)

    lower_builtin(function, *[Vector] * of)(implementation)


def _arithmetic(name: str) -> Callable[[Any, Vector, Any, Any], Any]:
    def lower(builder: Any, kind: Vector, a: Any, b: Any) -> Any:
        prefix = "f" if isinstance(kind.dtype, types.Float) else ""
        return getattr(builder, prefix + name)(a, b)

    return lower


def _comparison(sign: str) -> Callable[[Any, Vector, Any, Any], Any]:
    return lambda builder, kind, a, b: builder.fcmp_ordered(sign, a, b)


def _by_name(name: str) -> Callable[[Any, Vector, Any], Any]:
    return lambda builder, kind, a: _call(builder, name, kind, [a])


def _choice(sign: str) -> Callable[[Any, Vector, Any, Any], Any]:
    """The first number if ``sign`` holds, else the second: also where one is NaN."""
    return lambda builder, kind, a, b: builder.select(builder.fcmp_ordered(sign, a, b), a, b)


for _function, _name in (
    (operator.add, "add"), (operator.sub, "sub"), (operator.mul, "mul"), (operator.truediv, "div"),
):  # fmt: skip
    _operator(_function, _arithmetic(_name))
for _function, _name in (
    (operator.lt, "<"), (operator.le, "<="), (operator.gt, ">"), (operator.ge, ">="),
):  # fmt: skip
    _operator(_function, _comparison(_name), truth=True)
_operator(operator.and_, lambda builder, kind, a, b: builder.and_(a, b))
_operator(operator.lshift, lambda builder, kind, a, b: builder.shl(a, b))
_operator(operator.rshift, lambda builder, kind, a, b: builder.ashr(a, b))
_operator(min, _choice("<"))
_operator(max, _choice(">"))
_operator(operator.neg, lambda builder, kind, a: builder.fneg(a), of=1)
_operator(abs, _by_name("fabs"), of=1)
_operator(math.sqrt, _by_name("sqrt"), of=1)
_operator(math.ceil, _by_name("ceil"), of=1)
_operator(math.floor, _by_name("floor"), of=1)


def _pointer(context: Any, builder: Any, kind: Any, array: Any, index: Any, to: Any) -> Any:
    """Where flat element ``index`` of a C-contiguous array is, as a pointer to ``to``."""
    data = context.make_array(kind)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), to.as_pointer())


def _size(array: Any) -> int:
    return int(array.dtype.bitwidth) // 8


@_intrinsic(prefer_literal=True)
def load(typing: Any, array: Any, index: Any, lanes: Any) -> Any:
    """``lanes`` numbers of an array from flat ``index`` on."""
    kind = Vector(array.dtype, lanes.literal_value)

    def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        pointer = _pointer(context, builder, array, args[0], args[1], kind.llvm)
        return builder.load(pointer, align=_size(array))

    return kind(array, types.intp, lanes), code


@_intrinsic
def item(typing: Any, array: Any, index: Any) -> Any:
    """Flat element ``index``, which is never negative: without Python's test for that."""

    def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        data = context.make_array(array)(context, builder, args[0]).data
        return builder.load(builder.gep(data, [args[1]]))

    return array.dtype(array, types.intp), code


@_intrinsic
def put(typing: Any, array: Any, index: Any, value: Any) -> Any:
    """Writes flat element ``index``, which is never negative."""

    def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        data = context.make_array(array)(context, builder, args[0]).data
        builder.store(args[2], builder.gep(data, [args[1]]))
        return context.get_dummy_value()

    return types.void(array, types.intp, array.dtype), code


@_intrinsic(prefer_literal=True)
def column(typing: Any, array: Any, row: Any, number: Any, width: Any, lanes: Any) -> Any:
    """Column ``number`` of ``lanes`` rows of an array [N, width], from ``row`` on."""
    kind, step = Vector(array.dtype, lanes.literal_value), width.literal_value
    whole = Vector(array.dtype, kind.lanes * step)
    picked = [number.literal_value + step * lane for lane in range(kind.lanes)]

    def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        index = builder.mul(args[1], ir.Constant(args[1].type, step))
        pointer = _pointer(context, builder, array, args[0], index, whole.llvm)
        rows = builder.load(pointer, align=_size(array))
        return builder.shuffle_vector(rows, rows, _lanes(picked))

    return kind(array, types.intp, number, width, lanes), code


@_intrinsic
def store(typing: Any, array: Any, index: Any, vector: Any) -> Any:
    """Writes a vector to flat ``index`` of an array."""

    def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        pointer = _pointer(context, builder, array, args[0], args[1], vector.llvm)
        builder.store(args[2], pointer, align=_size(array))
        return context.get_dummy_value()

    return types.void(array, types.intp, vector), code


@_intrinsic
def interleave(typing: Any, a: Any, b: Any, c: Any) -> Any:
    """``a[0], b[0], c[0], a[1], ...``, three times as many lanes."""
    kind, n = Vector(a.dtype, 3 * a.lanes), a.lanes

    def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        first, second, third = args
        pair = builder.shuffle_vector(first, second, _lanes(list(range(2 * n))))
        last = builder.shuffle_vector(third, third, _lanes(list(range(2 * n))))
        picked = [lane + at for lane in range(n) for at in (0, n, 2 * n)]
        return builder.shuffle_vector(pair, last, _lanes(picked))

    return kind(a, a, a), code


@_intrinsic
def fma(typing: Any, a: Any, b: Any, c: Any) -> Any:
    """``a * b + c``, rounded once if that is as fast, else twice."""
    kind = next(k for k in (a, b, c) if isinstance(k, Vector))

    def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return _call(builder, "fmuladd", kind, args)

    return kind(kind, kind, kind), code


@_intrinsic
def select(typing: Any, mask: Any, a: Any, b: Any) -> Any:
    """``a`` where the mask is set, else ``b``."""
    kind = next(k for k in (a, b) if isinstance(k, Vector))

    def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.select(*args)

    return kind(mask, kind, kind), code


@_intrinsic
def bits(typing: Any, mask: Any) -> Any:
    """A mask as an int64, lane 0 lowest."""

    def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        number = builder.bitcast(args[0], ir.IntType(mask.lanes))
        return builder.zext(number, ir.IntType(64))

    return types.int64(mask), code


@_intrinsic
def view(typing: Any, vector: Any, dtype: Any) -> Any:
    """The same bits as another type of the same size."""
    kind = vector.of(dtype.dtype)

    def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.bitcast(args[0], kind.llvm)

    return kind(vector, dtype), code


@_intrinsic
def convert(typing: Any, vector: Any, dtype: Any) -> Any:
    """The same numbers in another type; integers from floats lose their fraction."""
    kind = vector.of(dtype.dtype)

    def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        if isinstance(vector.dtype, types.Integer):
            return builder.sitofp(args[0], kind.llvm)
        if isinstance(kind.dtype, types.Integer):
            return builder.fptosi(args[0], kind.llvm)
        widen = kind.dtype.bitwidth > vector.dtype.bitwidth
        return (builder.fpext if widen else builder.fptrunc)(args[0], kind.llvm)

    return kind(vector, dtype), code


@_intrinsic
def popcount(typing: Any, number: Any) -> Any:
    """How many bits are set."""

    def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.ctpop(args[0])

    return types.int64(types.int64), code


@_intrinsic
def prefetch(typing: Any, array: Any, index: Any) -> Any:
    """Asks for the cache line of flat ``index``; a wrong index does no harm."""

    def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        pointer = _pointer(context, builder, array, args[0], args[1], ir.IntType(8))
        to_read = [pointer, _int(0), _int(3), _int(1)]
        declared = ir.FunctionType(ir.VoidType(), [a.type for a in to_read])
        name = "llvm.prefetch.p0"
        builder.call(cgutils.get_or_insert_function(builder.module, declared, name), to_read)
        return context.get_dummy_value()

    return types.void(array, types.intp), code


_MANTISSA_BITS, _THREE_QUARTERS = np.int32(23), np.float32(0.75).view(np.int32)
# log2(m) = t L1 (1 + t^2 / 3 + t^4 / 5 + ...) where t = (m - 1) / (m + 1)
_ONE = np.float32(1)
_L1, _L3, _L5, _L7, _L9 = (np.float32(c) for c in (2 / math.log(2), 1 / 3, 1 / 5, 1 / 7, 1 / 9))


@kernel
def log2(a: Any) -> Any:
    """Binary logarithms of positive float32s that are not denormal, within 2e-7."""
    whole = (view(a, np.int32) - _THREE_QUARTERS) >> _MANTISSA_BITS
    m = view(view(a, np.int32) - (whole << _MANTISSA_BITS), np.float32)  # in 3/4 .. 3/2
    t = (m - _ONE) / (m + _ONE)
    t2 = t * t
    series = fma(fma(fma(fma(t2, _L9, _L7), t2, _L5), t2, _L3), t2, _ONE)
    return fma(t * _L1, series, convert(whole, np.float32))

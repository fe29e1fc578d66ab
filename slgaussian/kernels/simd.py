"""Explicit SIMD in Numba functions, with vectors of sixteen numbers.

LLVM's auto-vectoriser fails on loops that access several arrays or contain branches. A vector here
is one LLVM value, which the usual arithmetic operators combine with vectors and scalars. It is
compiled to SSE, AVX or NEON, in several registers if one is too narrow. Products and sums may be
fused, which only reduces rounding errors. Names start with ``v`` to distinguish them from NumPy's.

Vectors can only be variables inside ``njit`` functions and arguments between them.
"""

from __future__ import annotations

import operator
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, lower_builtin, models, register_model, type_callable

from slgaussian.kernels.jit import kernel

LANES = 16


class _Vector(types.Type):
    """:data:`LANES` float32, float64 or bool values."""

    def __init__(self, dtype: types.Type) -> None:
        self.dtype = dtype
        super().__init__(name=f"Vector({dtype}, {LANES})")


_F32, _F64, _MASK = _Vector(types.float32), _Vector(types.float64), _Vector(types.boolean)
_LLVM = {
    types.float32: ir.FloatType(),
    types.float64: ir.DoubleType(),
    types.boolean: ir.IntType(1),
}


@register_model(_Vector)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: _Vector) -> None:
        super().__init__(manager, kind, ir.VectorType(_LLVM[kind.dtype], LANES))


def _floats(kind: types.Type) -> bool:
    return isinstance(kind, _Vector) and kind.dtype != types.boolean


def _spread(context, builder, value, kind, target):
    """Return ``value`` of type ``kind`` as a vector ``target``: vectors as is, scalars repeated."""
    if isinstance(kind, _Vector):
        return value
    scalar = context.cast(builder, value, kind, target.dtype)
    vector = ir.Constant(ir.VectorType(scalar.type, LANES), ir.Undefined)
    vector = builder.insert_element(vector, scalar, ir.IntType(32)(0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    return builder.shuffle_vector(vector, vector, zeros)


def _float_operands(a: types.Type, b: types.Type) -> bool:
    return (_floats(a) and (a == b or isinstance(b, types.Number))) or (
        _floats(b) and isinstance(a, types.Number)
    )


def _mask_operands(a: types.Type, b: types.Type) -> bool:
    return a == b == _MASK


def _install(function, emit, applies, mask=False):
    """Implement the operator ``function`` for vectors.

    It uses typing and lowering instead of ``overload``, which Numba would inline at every use, so
    that kernels would take much longer to compile.
    """

    @type_callable(function)
    def _(context):
        def result(a, b):
            if not applies(a, b):
                return None
            return _MASK if mask else a if isinstance(a, _Vector) else b

        return result

    def lower(context, builder, signature, args):
        target = next(kind for kind in signature.args if isinstance(kind, _Vector))
        left, right = (
            _spread(context, builder, v, k, target)
            for v, k in zip(args, signature.args, strict=True)
        )
        return emit(builder, left, right)

    for kinds in ((_Vector, _Vector), (_Vector, types.Number), (types.Number, _Vector)):
        lower_builtin(function, *kinds)(lower)


@type_callable(operator.neg)
def _(context):
    return lambda vector: vector if _floats(vector) else None


@lower_builtin(operator.neg, _Vector)
def _(context, builder, signature, args):
    return builder.fneg(args[0])


def _comparison(sign):
    return lambda builder, a, b: builder.fcmp_ordered(sign, a, b)


_fused = ("contract",)
for _operator, _emit in {
    operator.add: lambda builder, a, b: builder.fadd(a, b, flags=_fused),
    operator.sub: lambda builder, a, b: builder.fsub(a, b, flags=_fused),
    operator.mul: lambda builder, a, b: builder.fmul(a, b, flags=_fused),
    operator.truediv: lambda builder, a, b: builder.fdiv(a, b),
}.items():
    _install(_operator, _emit, _float_operands)
for _operator, _sign in {
    operator.lt: "<",
    operator.le: "<=",
    operator.gt: ">",
    operator.ge: ">=",
}.items():
    _install(_operator, _comparison(_sign), _float_operands, mask=True)
_install(operator.and_, lambda builder, a, b: builder.and_(a, b), _mask_operands)


def _address(context, builder, array_type, array, index):
    data = context.make_array(array_type)(context, builder, array).data
    vector = ir.VectorType(_LLVM[array_type.dtype], LANES)
    return builder.bitcast(builder.gep(data, [index]), vector.as_pointer())


@intrinsic
def vload(typing, array, index):
    """Return the vector at ``array[index : index + LANES]``; ``array`` is 1-D and contiguous."""

    def lower(context, builder, signature, args):
        value = builder.load(_address(context, builder, signature.args[0], args[0], args[1]))
        value.align = array.dtype.bitwidth // 8
        return value

    return _Vector(array.dtype)(array, types.intp), lower


@intrinsic
def vstore(typing, array, index, vector):
    """Write ``vector`` to ``array[index : index + LANES]``."""

    def lower(context, builder, signature, args):
        place = _address(context, builder, signature.args[0], args[0], args[1])
        builder.store(args[2], place).align = array.dtype.bitwidth // 8
        return context.get_dummy_value()

    return types.none(array, types.intp, vector), lower


@intrinsic
def prefetch(typing, array, index):
    """Prefetch the cache line of element ``index`` of a contiguous ``array``."""

    def lower(context, builder, signature, args):
        data = context.make_array(array)(context, builder, args[0]).data
        place = builder.bitcast(builder.gep(data, [args[1]]), ir.IntType(8).as_pointer())
        int32 = ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [place.type, int32, int32, int32])
        function = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0i8")
        builder.call(function, [place, int32(0), int32(3), int32(1)])
        return context.get_dummy_value()

    return types.none(array, types.intp), lower


@intrinsic
def lowest_bit(typing, bits):
    """Return the index of the lowest set bit of a non-zero uint32."""

    def lower(context, builder, signature, args):
        return builder.cttz(args[0], ir.IntType(1)(1))

    return types.uint32(types.uint32), lower


@intrinsic
def vzero(typing):
    """Return a float32 vector of zeros."""

    def lower(context, builder, signature, args):
        return ir.Constant(ir.VectorType(ir.FloatType(), LANES), [0.0] * LANES)

    return _F32(), lower


@intrinsic
def vwhere(typing, mask, a, b):
    """Return ``a`` where ``mask`` is true, else ``b``; at most one of them may be a scalar.

    With a scalar mask, ``a`` and ``b`` are float64 scalars, so that formulas work for both.
    """
    if isinstance(mask, types.Boolean):
        return types.float64(
            mask, types.float64, types.float64
        ), lambda _, builder, __, args: builder.select(*args)
    target = a if isinstance(a, _Vector) else b

    def lower(context, builder, signature, args):
        left, right = (
            _spread(context, builder, v, k, target)
            for v, k in zip(args[1:], signature.args[1:], strict=True)
        )
        return builder.select(args[0], left, right)

    return target(mask, a, b), lower


@intrinsic
def vsum(typing, vector):
    """Return the sum of the elements, always in the same order."""

    def lower(context, builder, signature, args):
        value, width = args[0], LANES
        while width > 1:
            width //= 2
            upper = ir.Constant(
                ir.VectorType(ir.IntType(32), width), [width + i for i in range(width)]
            )
            lower_half = ir.Constant(ir.VectorType(ir.IntType(32), width), list(range(width)))
            value = builder.fadd(
                builder.shuffle_vector(value, value, lower_half),
                builder.shuffle_vector(value, value, upper),
            )
        return builder.extract_element(value, ir.IntType(32)(0))

    return vector.dtype(vector), lower


def _reduction(emit):
    @intrinsic
    def reduction(typing, mask):
        def lower(context, builder, signature, args):
            return emit(builder, builder.bitcast(args[0], ir.IntType(LANES)))

        return types.boolean(mask), lower

    return reduction


vany = _reduction(lambda builder, bits: builder.icmp_unsigned("!=", bits, bits.type(0)))
"""``vany(mask)``: whether any element is true."""

vall = _reduction(lambda builder, bits: builder.icmp_unsigned("==", bits, bits.type(-1)))
"""``vall(mask)``: whether every element is true."""


def _function(name):
    @intrinsic
    def function(typing, vector):
        def lower(context, builder, signature, args):
            kind = args[0].type
            suffix = "f32" if vector.dtype == types.float32 else "f64"
            callee = cgutils.get_or_insert_function(
                builder.module, ir.FunctionType(kind, [kind]), f"llvm.{name}.v{LANES}{suffix}"
            )
            return builder.call(callee, args)

        return vector(vector), lower

    return function


vsqrt, vfloor, vceil, vabs = (_function(name) for name in ("sqrt", "floor", "ceil", "fabs"))


@intrinsic
def vwiden(typing, vector):
    """Convert a float32 vector to float64."""
    return _F64(vector), lambda _, builder, signature, args: builder.fpext(
        args[0], ir.VectorType(ir.DoubleType(), LANES)
    )


@intrinsic
def vnarrow(typing, vector):
    """Round a float64 vector to float32."""
    return _F32(vector), lambda _, builder, signature, args: builder.fptrunc(
        args[0], ir.VectorType(ir.FloatType(), LANES)
    )


@intrinsic
def _shift_exponent(typing, vector, magic):
    """Return ``vector`` times 2^n, where n is the integer in the last bits of ``magic``."""

    def lower(context, builder, signature, args):
        bits = ir.VectorType(ir.IntType(32), LANES)
        n = builder.shl(builder.bitcast(args[1], bits), ir.Constant(bits, [23] * LANES))
        return builder.bitcast(builder.add(builder.bitcast(args[0], bits), n), args[0].type)

    return vector(vector, magic), lower


MAGIC = np.float32(1.5 * 2**23)
"""Constant that, added to a small number, leaves the nearest integer in the last bits."""


@kernel
def vexp2(x):
    """Return 2 to the power of a float32 vector, at most 127; for x below -100, 2^-100.

    Relative error 1.5e-7: a polynomial of degree 5 on [-1/2, 1/2] (minimax, 9.1e-8, and exact at
    0) and a shift.
    """
    x = vwhere(x > np.float32(-100), x, np.float32(-100))
    magic = x + MAGIC
    t = x - (magic - MAGIC)
    p = t * np.float32(1.3264727123566361e-3) + np.float32(9.671512644824094e-3)
    p = t * p + np.float32(5.550733743497081e-2)
    p = t * p + np.float32(2.4022242085262316e-1)
    p = t * p + np.float32(6.931469775989922e-1)
    p = t * p + np.float32(1)
    return _shift_exponent(p, magic)


def _split(emit):
    @intrinsic
    def part(typing, vector):
        def lower(context, builder, signature, args):
            kind = ir.VectorType(ir.IntType(32), LANES)

            def every(number):
                return ir.Constant(kind, [number] * LANES)

            bits = builder.bitcast(args[0], kind)
            exponent = builder.ashr(builder.sub(bits, every(ROOT_HALF)), every(23))
            return emit(builder, bits, exponent, every, args[0].type)

        return vector(vector), lower

    return part


ROOT_HALF = int(np.float32(np.sqrt(0.5)).view(np.int32))

_exponent = _split(lambda builder, bits, exponent, every, kind: builder.sitofp(exponent, kind))
_mantissa = _split(
    lambda builder, bits, exponent, every, kind: builder.bitcast(
        builder.sub(bits, builder.shl(exponent, every(23))), kind
    )
)


@kernel
def vlog2(x):
    """Return the binary logarithm of a positive float32 vector; about -127 for 0.

    Relative error 2e-7, near 1 too: the series of the inverse hyperbolic tangent.
    """
    m = _mantissa(x)  # in [sqrt(1/2), sqrt(2))
    s = (m - np.float32(1)) / (m + np.float32(1))
    q = s * s
    p = q * np.float32(2 / (9 * np.log(2))) + np.float32(2 / (7 * np.log(2)))
    p = q * p + np.float32(2 / (5 * np.log(2)))
    p = q * p + np.float32(2 / (3 * np.log(2)))
    p = q * p + np.float32(2 / np.log(2))
    return s * p + _exponent(x)

"""Explicit SIMD in Numba functions, with vectors of sixteen numbers.

LLVM's auto-vectoriser fails on loops that access several arrays or contain branches. A vector here
is one LLVM value, which the usual arithmetic operators combine with vectors and scalars. It is
compiled to SSE, AVX or NEON, in several registers if one is too narrow. Products and sums may be
fused, which only reduces rounding errors. Names start with ``v`` to distinguish them from NumPy's.

Vectors can only be variables inside ``njit`` functions and arguments between them.
"""

from __future__ import annotations

import operator
from functools import partial
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, lower_builtin, models, register_model, type_callable

from slgaussian.kernels.jit import kernel

LANES = 16

_LLVM = {
    types.float32: ir.FloatType(), types.float64: ir.DoubleType(), types.boolean: ir.IntType(1),
}  # fmt: skip
_INT32 = ir.IntType(32)
_INTS = ir.VectorType(_INT32, LANES)


class _Vector(types.Type):
    """:data:`LANES` float32, float64 or bool values."""

    def __init__(self, dtype: types.Type) -> None:
        self.dtype = dtype
        super().__init__(name=f"Vector({dtype}, {LANES})")

    @property
    def llvm(self) -> ir.Type:
        return ir.VectorType(_LLVM[self.dtype], LANES)


_F32, _F64, _MASK = _Vector(types.float32), _Vector(types.float64), _Vector(types.boolean)


@register_model(_Vector)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: _Vector) -> None:
        super().__init__(manager, kind, kind.llvm)


def _floats(kind: types.Type) -> bool:
    return isinstance(kind, _Vector) and kind.dtype != types.boolean


def _broadcast(context, builder, value, kind, target):
    """Return ``value`` of type ``kind`` as a vector ``target``: vectors as is, scalars repeated."""
    if isinstance(kind, _Vector):
        return value
    scalar = context.cast(builder, value, kind, target.dtype)
    vector = ir.Constant(ir.VectorType(scalar.type, LANES), ir.Undefined)
    vector = builder.insert_element(vector, scalar, _INT32(0))
    zeros = ir.Constant(_INTS, [0] * LANES)
    return builder.shuffle_vector(vector, vector, zeros)


def _float_operands(a: types.Type, b: types.Type) -> bool:
    return (_floats(a) and (a == b or isinstance(b, types.Number))) or (
        _floats(b) and isinstance(a, types.Number)
    )


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
            _broadcast(context, builder, v, k, target)
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


_fused = ("contract",)
for _operator, _emit in {
    operator.add: lambda builder, a, b: builder.fadd(a, b, flags=_fused),
    operator.sub: lambda builder, a, b: builder.fsub(a, b, flags=_fused),
    operator.mul: lambda builder, a, b: builder.fmul(a, b, flags=_fused),
    operator.truediv: lambda builder, a, b: builder.fdiv(a, b),
}.items():
    _install(_operator, _emit, _float_operands)
for _operator, _sign in (
    (operator.lt, "<"), (operator.le, "<="), (operator.gt, ">"), (operator.ge, ">="),
):  # fmt: skip
    _emit = partial(lambda sign, builder, a, b: builder.fcmp_ordered(sign, a, b), _sign)
    _install(_operator, _emit, _float_operands, mask=True)
_install(operator.and_, lambda builder, a, b: builder.and_(a, b), lambda a, b: a == b == _MASK)


def _address(context, builder, array_type, array, index, target=None):
    """Return a pointer to an element, for access as ``target``, by default a vector."""
    data = context.make_array(array_type)(context, builder, array).data
    target = target or ir.VectorType(_LLVM[array_type.dtype], LANES)
    return builder.bitcast(builder.gep(data, [index]), target.as_pointer())


@intrinsic
def vload(typing, array, index):
    """Return the vector at ``array[index : index + LANES]``; ``array`` is 1-D and contiguous."""

    def lower(context, builder, signature, args):
        value = builder.load(_address(context, builder, array, *args))
        value.align = array.dtype.bitwidth // 8
        return value

    return _Vector(array.dtype)(array, types.intp), lower


@intrinsic
def vstore(typing, array, index, vector):
    """Write ``vector`` to ``array[index : index + LANES]``."""

    def lower(context, builder, signature, args):
        place = _address(context, builder, array, *args[:2])
        builder.store(args[2], place).align = array.dtype.bitwidth // 8
        return context.get_dummy_value()

    return types.none(array, types.intp, vector), lower


@intrinsic
def prefetch(typing, array, index):
    """Prefetch the cache line of element ``index`` of a contiguous ``array``."""

    def lower(context, builder, signature, args):
        place = _address(context, builder, array, args[0], args[1], ir.IntType(8))
        kind = ir.FunctionType(ir.VoidType(), [place.type, _INT32, _INT32, _INT32])
        function = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0i8")
        builder.call(function, [place, _INT32(0), _INT32(3), _INT32(1)])
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
        number = types.float64
        return number(mask, number, number), lambda _, builder, __, args: builder.select(*args)
    target = a if isinstance(a, _Vector) else b

    def lower(context, builder, signature, args):
        left, right = (
            _broadcast(context, builder, v, k, target)
            for v, k in zip(args[1:], signature.args[1:], strict=True)
        )
        return builder.select(args[0], left, right)

    return target(mask, a, b), lower


def _unary(result, emit):
    """Make an intrinsic of one vector.

    ``result`` returns the type of its value from that of the vector, ``emit`` the value.
    """

    @intrinsic
    def function(typing, vector):
        return result(vector)(vector), lambda _, builder, __, args: emit(builder, args[0])

    return function


def _sum(builder, value):
    width = LANES
    while width > 1:
        width //= 2
        kind = ir.VectorType(_INT32, width)
        halves = (ir.Constant(kind, [k + i for i in range(width)]) for k in (0, width))
        value = builder.fadd(*(builder.shuffle_vector(value, value, half) for half in halves))
    return builder.extract_element(value, _INT32(0))


def _call(name, builder, value):
    suffix = "f32" if value.type.element == ir.FloatType() else "f64"
    kind = ir.FunctionType(value.type, [value.type])
    function = f"llvm.{name}.v{LANES}{suffix}"
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, function), [value])


def _mask_equals(sign, bits, builder, mask):
    every = builder.bitcast(mask, ir.IntType(LANES))
    return builder.icmp_unsigned(sign, every, every.type(bits))


ROOT_HALF = int(np.float32(np.sqrt(0.5)).view(np.int32))


def _split(builder, value):
    """Return the bits of floats, and the exponents that leave mantissas in [sqrt(1/2), sqrt(2))."""
    bits = builder.bitcast(value, _INTS)
    above = builder.sub(bits, ir.Constant(_INTS, [ROOT_HALF] * LANES))
    return bits, builder.ashr(above, ir.Constant(_INTS, [23] * LANES))


def _emit_exponent(builder, value):
    return builder.sitofp(_split(builder, value)[1], value.type)


def _emit_mantissa(builder, value):
    bits, exponent = _split(builder, value)
    shifted = builder.shl(exponent, ir.Constant(_INTS, [23] * LANES))
    return builder.bitcast(builder.sub(bits, shifted), value.type)


vsum = _unary(lambda vector: vector.dtype, _sum)
"""``vsum(vector)``: the sum of the elements, always in the same order."""

vany = _unary(lambda _: types.boolean, partial(_mask_equals, "!=", 0))
"""``vany(mask)``: whether any element is true."""

vall = _unary(lambda _: types.boolean, partial(_mask_equals, "==", -1))
"""``vall(mask)``: whether every element is true."""

vsqrt, vfloor, vceil, vabs, _exponent, _mantissa = (
    _unary(lambda vector: vector, emit)
    for emit in (
        partial(_call, "sqrt"), partial(_call, "floor"), partial(_call, "ceil"),
        partial(_call, "fabs"), _emit_exponent, _emit_mantissa,
    )
)  # fmt: skip

vwiden = _unary(lambda _: _F64, lambda builder, value: builder.fpext(value, _F64.llvm))
"""``vwiden(vector)``: a float32 vector in float64."""

vnarrow = _unary(lambda _: _F32, lambda builder, value: builder.fptrunc(value, _F32.llvm))
"""``vnarrow(vector)``: a float64 vector rounded to float32."""


@intrinsic
def _shift_exponent(typing, vector, magic):
    """Return ``vector`` times 2^n, where n is the integer in the last bits of ``magic``."""

    def lower(context, builder, signature, args):
        n = builder.shl(builder.bitcast(args[1], _INTS), ir.Constant(_INTS, [23] * LANES))
        return builder.bitcast(builder.add(builder.bitcast(args[0], _INTS), n), args[0].type)

    return vector(vector, magic), lower


MAGIC = np.float32(1.5 * 2**23)
"""Constant that, added to a small number, leaves the nearest integer in the last bits."""


@kernel
def vexp2(x):
    """Return 2 to the power of a float32 vector, at most 127; for x below -100, 2^-100.

    Relative error 1.5e-7: a polynomial of degree 5 on [-1/2, 1/2] (minimax, 9.1e-8, and exact at
    0) and a shift.
    """
    # x = n + t with n the nearest integer: 2^t by the polynomial, 2^n by adding n to the exponent's
    # bits. Adding MAGIC rounds x to n in its last bits, without a conversion to integers.
    x = vwhere(x > np.float32(-100), x, np.float32(-100))
    magic = x + MAGIC
    t = x - (magic - MAGIC)
    p = t * np.float32(1.3264727123566361e-3) + np.float32(9.671512644824094e-3)
    p = t * p + np.float32(5.550733743497081e-2)
    p = t * p + np.float32(2.4022242085262316e-1)
    p = t * p + np.float32(6.931469775989922e-1)
    p = t * p + np.float32(1)
    return _shift_exponent(p, magic)


@kernel
def vlog2(x):
    """Return the binary logarithm of a positive float32 vector; about -127 for 0.

    Relative error 2e-7, near 1 too: the series of the inverse hyperbolic tangent.
    """
    # log2 m = 2 / ln 2 artanh s with s = (m - 1) / (m + 1): s is exact near m = 1, where a
    # polynomial in m - 1 of float32 would lose digits, and |s| < 0.172 needs five terms.
    m = _mantissa(x)  # in [sqrt(1/2), sqrt(2))
    s = (m - np.float32(1)) / (m + np.float32(1))
    q = s * s
    p = q * np.float32(2 / (9 * np.log(2))) + np.float32(2 / (7 * np.log(2)))
    p = q * p + np.float32(2 / (5 * np.log(2)))
    p = q * p + np.float32(2 / (3 * np.log(2)))
    p = q * p + np.float32(2 / np.log(2))
    return s * p + _exponent(x)

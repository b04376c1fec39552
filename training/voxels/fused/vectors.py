"""Rows of eight floats as one vector: the few operations that Numba does not vectorise by itself.

A row of the grid is 8 channels of float32, 32 bytes: one AVX register, or two of SSE and NEON. LLVM picks the
instructions of the machine at hand. Arrays are C-contiguous; indices are not checked.

Notation: rows [V, 8] and the like; n an index into the first axis.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

LANES = 8
TINY = float(np.float32(1e-20))  # keeps the root of a second moment from zero; LLVM wants a float32 exactly
_FLOAT = ir.FloatType()
_VECTOR = ir.VectorType(_FLOAT, LANES)


class _Row:
    """Loads and stores row n of a two-dimensional float32 array as a vector."""

    def __init__(self, context: Any, builder: ir.IRBuilder, array_type: Any, value: Any, n: Any) -> None:
        self.builder = builder
        data = cgutils.create_struct_proxy(array_type)(context, builder, value).data
        offset = builder.mul(_as_index(builder, n), ir.Constant(ir.IntType(64), LANES))
        self.pointer = builder.bitcast(builder.gep(data, [offset]), ir.PointerType(_VECTOR))

    def load(self) -> Any:
        return self.builder.load(self.pointer, align=4)

    def store(self, vector: Any) -> None:
        self.builder.store(vector, self.pointer, align=4)


def _as_index(builder: ir.IRBuilder, n: Any) -> Any:
    return n if n.type.width == 64 else builder.sext(n, ir.IntType(64))


def _splat(builder: ir.IRBuilder, scalar: Any) -> Any:
    """All lanes the same."""
    one = builder.insert_element(ir.Constant(_VECTOR, ir.Undefined), scalar, ir.Constant(ir.IntType(32), 0))
    lanes = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    return builder.shuffle_vector(one, ir.Constant(_VECTOR, ir.Undefined), lanes)


def _fma(builder: ir.IRBuilder, a: Any, b: Any, c: Any) -> Any:
    return _call(builder, "llvm.fmuladd.v8f32", a, b, c)


def _call(builder: ir.IRBuilder, name: str, *operands: Any) -> Any:
    """An LLVM intrinsic of vectors."""
    kind = ir.FunctionType(_VECTOR, [_VECTOR] * len(operands))
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, name), operands)


def _returns_nothing(context: Any) -> Any:
    return context.get_dummy_value()


@intrinsic
def population_count(typing_context, bits):
    """How many bits of a uint64 are set, as int64."""

    def generate(context, builder, signature, arguments):
        function = builder.module.declare_intrinsic("llvm.ctpop", [ir.IntType(64)])
        return builder.call(function, [arguments[0]])

    return types.int64(types.uint64), generate


@intrinsic
def blend(typing_context, rows, ids, weights, n, out):
    """out[n] = sum over k of weights[n, k] rows[ids[n, k]]: rows [V, 8], ids int32 [S, 8], weights [S, 8], out [S, 8]."""

    def generate(context, builder, signature, arguments):
        rows, ids, weights, n, out = arguments
        kinds = signature.args
        id_data = cgutils.create_struct_proxy(kinds[1])(context, builder, ids).data
        weight = _Row(context, builder, kinds[2], weights, n).load()
        first = builder.mul(_as_index(builder, n), ir.Constant(ir.IntType(64), LANES))
        total = ir.Constant(_VECTOR, [0.0] * LANES)
        for k in range(LANES):
            where = builder.gep(id_data, [builder.add(first, ir.Constant(ir.IntType(64), k))])
            row = _Row(context, builder, kinds[0], rows, builder.load(where)).load()
            lane = builder.extract_element(weight, ir.Constant(ir.IntType(32), k))
            total = _fma(builder, _splat(builder, lane), row, total)
        _Row(context, builder, kinds[4], out, n).store(total)
        return _returns_nothing(context)

    return types.void(rows, ids, weights, n, out), generate


@intrinsic
def add_scaled(typing_context, target, n, weight, source, m):
    """target[n] += weight source[m]: target [V, 8], source [S, 8], weight float32."""

    def generate(context, builder, signature, arguments):
        target, n, weight, source, m = arguments
        into = _Row(context, builder, signature.args[0], target, n)
        vector = _Row(context, builder, signature.args[3], source, m).load()
        into.store(_fma(builder, _splat(builder, weight), vector, into.load()))
        return _returns_nothing(context)

    return types.void(target, n, types.float32, source, m), generate


@intrinsic
def adam_row(typing_context, rows, first, second, slope, n, rates, scale, keep1, keep2):
    """Adam for row n of rows, first and second moments [V, 8] under slope [V, 8], which is set to zero.

    rates [1, 8]: learning rates with the bias correction. scale: factor on the slope. keep1, keep2: the betas. All float32.
    """

    def generate(context, builder, signature, arguments):
        rows, first, second, slope, n, rates, scale, keep1, keep2 = arguments
        kinds = signature.args
        value, one, two, change = (
            _Row(context, builder, kind, array, n)
            for kind, array in zip(kinds[:4], (rows, first, second, slope), strict=True)
        )
        zero = ir.Constant(ir.IntType(64), 0)
        rate = _Row(context, builder, kinds[5], rates, zero).load()
        gradient = builder.fmul(change.load(), _splat(builder, scale))
        ones = ir.Constant(_VECTOR, [1.0] * LANES)

        def towards(old, new, keep):
            step = builder.fsub(ones, _splat(builder, keep))
            return _fma(builder, step, builder.fsub(new, old), old)

        new_one = towards(one.load(), gradient, keep1)
        new_two = towards(two.load(), builder.fmul(gradient, gradient), keep2)
        tiny = _splat(builder, ir.Constant(_FLOAT, TINY))
        root = _call(builder, "llvm.sqrt.v8f32", builder.fadd(new_two, tiny))
        value.store(builder.fsub(value.load(), builder.fdiv(builder.fmul(rate, new_one), root)))
        one.store(new_one)
        two.store(new_two)
        change.store(ir.Constant(_VECTOR, [0.0] * LANES))
        return _returns_nothing(context)

    signature = types.void(rows, first, second, slope, n, rates, types.float32, types.float32, types.float32)
    return signature, generate

"""SIMD operations for LLVM: small matrix products in registers, rows of four floats, prefetching.

Numba does not vectorise these by itself. Arrays are C-contiguous float32 and are addressed flat, in elements from their first;
indices are not checked. LLVM picks the instructions of the machine at hand.

Notation: a row of a feature table is 4 floats; n is its number.
"""

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

FEATURES = 4  # floats of a row of a feature table
LINE = 16  # floats of a line of the cache
_FLOAT, _INT = ir.FloatType(), ir.IntType(64)
_ROW = ir.VectorType(_FLOAT, FEATURES)


def _data(context: Any, builder: ir.IRBuilder, kind: Any, array: Any) -> Any:
    return cgutils.create_struct_proxy(kind)(context, builder, array).data


def _wide(builder: ir.IRBuilder, index: Any) -> Any:
    return index if index.type.width == 64 else builder.sext(index, _INT)


def _vector_at(builder: ir.IRBuilder, data: Any, index: Any, kind: Any) -> Any:
    return builder.bitcast(builder.gep(data, [index]), ir.PointerType(kind))


def _splat(builder: ir.IRBuilder, scalar: Any, kind: Any) -> Any:
    zero, undefined = ir.Constant(ir.IntType(32), 0), ir.Constant(kind, ir.Undefined)
    lanes = ir.Constant(ir.VectorType(ir.IntType(32), kind.count), [0] * kind.count)
    return builder.shuffle_vector(builder.insert_element(undefined, scalar, zero), undefined, lanes)


def _multiply_add(builder: ir.IRBuilder, a: Any, b: Any, c: Any) -> Any:
    name = f"llvm.fmuladd.v{c.type.count}f32"
    kind = ir.FunctionType(c.type, [c.type] * 3)
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, name), [a, b, c])


def _tile_product(rows: int, lanes: int) -> Any:
    """An intrinsic that computes a tile [rows, lanes] of a matrix product, which stays in registers meanwhile."""
    vector = ir.VectorType(_FLOAT, lanes)

    def generate(context, builder, signature, arguments):
        left, right, out, bias = (cgutils.unpack_tuple(builder, matrix) for matrix in arguments[:4])
        kinds = [kind[0] for kind in signature.args[:4]]
        left_data, right_data, out_data, bias_data = (
            _data(context, builder, kind, matrix[0])
            for kind, matrix in zip(kinds, (left, right, out, bias), strict=True)
        )
        starts, sums = [], []
        for row in range(rows):
            number = ir.Constant(_INT, row)
            starts.append(builder.add(left[1], builder.mul(number, left[2])))
            begin = builder.add(bias[1], builder.mul(number, bias[2]))
            sums.append(cgutils.alloca_once(builder, vector))
            builder.store(builder.load(_vector_at(builder, bias_data, begin, vector), align=4), sums[row])
        with cgutils.for_range(builder, arguments[4], intp=_INT) as loop:
            place = builder.add(right[1], builder.mul(loop.index, right[2]))
            values = builder.load(_vector_at(builder, right_data, place, vector), align=4)
            along = builder.mul(loop.index, left[3])
            for start, total in zip(starts, sums, strict=True):
                factor = _splat(builder, builder.load(builder.gep(left_data, [builder.add(start, along)])), vector)
                builder.store(_multiply_add(builder, factor, values, builder.load(total)), total)
        least = _splat(builder, bias[3], vector)
        for row, total in enumerate(sums):
            value = builder.load(total)
            value = builder.select(builder.fcmp_ordered(">", value, least), value, least)
            offset = builder.add(out[1], builder.mul(ir.Constant(_INT, row), out[2]))
            builder.store(value, _vector_at(builder, out_data, offset, vector), align=4)
        return context.get_dummy_value()

    @intrinsic
    def tile_product(typing_context, left, right, out, bias, inner):
        """out[r, l] = max(least, bias[r, l] + sum over i < inner of left[r, i] right[i, l]).

        Matrices are tuples: left (array, start, stride of rows, stride of columns), right and out (array, start, stride of rows),
        bias (array, start, stride of rows, least), in elements of flat arrays.
        """
        return types.void(left, right, out, bias, types.int64), generate

    return tile_product


tile_product_4x16, tile_product_8x8 = _tile_product(4, 16), _tile_product(8, 8)


@intrinsic
def blend_row(typing_context, table, ids, weights, lane, stride, out, start):
    """out[start : start + 4] = sum over k of weights[k, lane] table[ids[k, lane]], k < 8; stride: lanes of ids and weights."""

    def generate(context, builder, signature, arguments):
        table, ids, weights, lane, stride, out, start = arguments
        kinds = signature.args
        rows, id_data, weight_data, target = (
            _data(context, builder, kinds[i], array) for i, array in ((0, table), (1, ids), (2, weights), (5, out))
        )
        total = ir.Constant(_ROW, [0.0] * FEATURES)
        for k in range(8):
            place = builder.add(lane, builder.mul(ir.Constant(_INT, k), stride))
            n = _wide(builder, builder.load(builder.gep(id_data, [place])))
            row = _vector_at(builder, rows, builder.mul(n, ir.Constant(_INT, FEATURES)), _ROW)
            weight = builder.load(builder.gep(weight_data, [place]))
            total = _multiply_add(builder, _splat(builder, weight, _ROW), builder.load(row, align=4), total)
        builder.store(total, _vector_at(builder, target, start, _ROW), align=4)
        return context.get_dummy_value()

    whole = types.int64
    return types.void(table, ids, weights, whole, whole, out, whole), generate


@intrinsic
def add_to_row(typing_context, table, n, weight, source, start):
    """table[n] += weight source[start : start + 4]."""

    def generate(context, builder, signature, arguments):
        table, n, weight, source, start = arguments
        kinds = signature.args
        rows, values = _data(context, builder, kinds[0], table), _data(context, builder, kinds[3], source)
        into = _vector_at(builder, rows, builder.mul(_wide(builder, n), ir.Constant(_INT, FEATURES)), _ROW)
        value = builder.load(_vector_at(builder, values, start, _ROW), align=4)
        total = _multiply_add(builder, _splat(builder, weight, _ROW), value, builder.load(into, align=4))
        builder.store(total, into, align=4)
        return context.get_dummy_value()

    return types.void(table, n, types.float32, source, types.int64), generate


@intrinsic
def colour_slopes(typing_context, slopes, at, values, start, weight, out):
    """out[start : start + 8] = weight s v (1 - v) of s = slopes[at : at + 8] and v = values[start : start + 8]; returns the sum
    of s v without the first."""

    def generate(context, builder, signature, arguments):
        slopes, at, values, start, weight, out = arguments
        kinds, vector = signature.args, ir.VectorType(_FLOAT, 8)
        slope, value = (
            builder.load(_vector_at(builder, _data(context, builder, kinds[i], array), place, vector), align=4)
            for i, array, place in ((0, slopes, at), (2, values, start))
        )
        product = builder.fmul(slope, builder.insert_element(value, ir.Constant(_FLOAT, 0.0), ir.Constant(_INT, 0)))
        ones = ir.Constant(vector, [1.0] * 8)
        scaled = builder.fmul(builder.fmul(product, builder.fsub(ones, value)), _splat(builder, weight, vector))
        builder.store(scaled, _vector_at(builder, _data(context, builder, kinds[5], out), start, vector), align=4)
        kind = ir.FunctionType(_FLOAT, [_FLOAT, vector])
        add = cgutils.get_or_insert_function(builder.module, kind, "llvm.vector.reduce.fadd.v8f32")
        return builder.call(add, [ir.Constant(_FLOAT, 0.0), product], fastmath=("reassoc",))

    whole = types.int64
    return types.float32(slopes, whole, values, whole, types.float32, out), generate


@intrinsic
def adam_line(typing_context, arrays, at, scale, decay, rate, settings):
    """Adam for the LINE floats of arrays (values, their first and second moments, gradient) from `at` on, by gradient * scale +
    decay * value, where that is not 0; the gradient is set to 0. settings: 1 - beta1, 1 - beta2, epsilon."""

    def generate(context, builder, signature, arguments):
        kind = ir.VectorType(_FLOAT, LINE)
        arrays, at, *factors = arguments
        scale, decay, rate, *settings = factors[:3] + cgutils.unpack_tuple(builder, factors[3])
        scale, decay, rate, new1, new2, epsilon = (
            _splat(builder, factor, kind) for factor in (scale, decay, rate, *settings)
        )
        places = [
            _vector_at(builder, _data(context, builder, of, array), at, kind)
            for of, array in zip(signature.args[0], cgutils.unpack_tuple(builder, arrays), strict=True)
        ]
        value, first, second, slope = (builder.load(place, align=4) for place in places)
        none = ir.Constant(kind, [0.0] * LINE)
        slope = builder.fadd(builder.fmul(slope, scale), builder.fmul(decay, value))
        moved = builder.fadd(first, builder.fmul(new1, builder.fsub(slope, first)))
        squared = builder.fadd(second, builder.fmul(new2, builder.fsub(builder.fmul(slope, slope), second)))
        root = cgutils.get_or_insert_function(builder.module, ir.FunctionType(kind, [kind]), f"llvm.sqrt.v{LINE}f32")
        below = builder.fadd(builder.call(root, [squared]), epsilon)
        new = builder.fsub(value, builder.fdiv(builder.fmul(rate, moved), below))
        learns = builder.fcmp_unordered("!=", slope, none)
        for after, before, place in zip((new, moved, squared), (value, first, second), places, strict=False):
            builder.store(builder.select(learns, after, before), place, align=4)
        builder.store(none, places[3], align=4)
        return context.get_dummy_value()

    number = types.float32
    return types.void(arrays, types.int64, number, number, number, settings), generate


@intrinsic
def prefetch_row(typing_context, table, n):
    """Asks for table[n] to be brought into the cache."""

    def generate(context, builder, signature, arguments):
        rows = _data(context, builder, signature.args[0], arguments[0])
        index = builder.mul(_wide(builder, arguments[1]), ir.Constant(_INT, FEATURES))
        byte, flag = ir.PointerType(ir.IntType(8)), ir.IntType(32)
        address = builder.bitcast(builder.gep(rows, [index]), byte)
        kind = ir.FunctionType(ir.VoidType(), [byte, flag, flag, flag])
        function = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0")
        builder.call(function, [address, *(ir.Constant(flag, value) for value in (0, 3, 1))])  # read, keep, data
        return context.get_dummy_value()

    return types.void(table, n), generate

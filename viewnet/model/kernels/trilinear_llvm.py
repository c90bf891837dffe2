"""Steps along a ray and the values there, several at once: what Numba does not vectorise by itself.

`voxels` are (P, 4) float32, contiguous; a cell is named by its lowest corner, and `row` and `plane` are how many voxels
further its neighbours along v and w are. A ray's steps are numbered from 0, where it enters: `places` (L,) has their
cells, `into` (3, L) how far into them they are along u, v and w, and `lit` (L,) lists those in occupied cells. L is
LANES more than the ray has steps at most, since LANES are found at a time.
"""

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

LANES = 8
FLOAT, INT, LONG = ir.FloatType(), ir.IntType(32), ir.IntType(64)
_three, _four = types.UniTuple(types.float32, 3), types.UniTuple(types.float32, 4)
_sides, _line = types.UniTuple(types.int32, 3), types.UniTuple(types.float32, 6)
_strides = types.UniTuple(types.uintp, 2)  # unsigned: no sign to check in indexing


@intrinsic
def locate(context, cells, line, first, count, shape, strides, places, into, lit):
    """Fills `places`, `into` and `lit` for `count` steps from the number `first` on; returns how many are lit.

    `line` is u, v and w at number 0 and their changes a step; `cells` (P,) says which cells are occupied. Cells
    outside `shape`, the last along u, v and w, become the nearest: whatever a ray is, memory is safe.
    """

    def generate(context, builder, signature, arguments):
        cells, places, into, lit = _data(context, builder, signature, arguments, 0, 6, 7, 8)
        line = [_splat(builder, number, LANES) for number in cgutils.unpack_tuple(builder, arguments[1])]
        first, count = arguments[2:4]
        last = [_splat(builder, number, LANES) for number in cgutils.unpack_tuple(builder, arguments[4])]
        strides = [builder.trunc(stride, INT) for stride in cgutils.unpack_tuple(builder, arguments[5])]
        length = _length(context, builder, signature, arguments, 7)
        nowhere = builder.trunc(builder.sub(_length(context, builder, signature, arguments, 0, 0), LONG(1)), INT)
        numbers, zeros = (ir.Constant(ir.VectorType(INT, LANES), lanes) for lanes in (list(range(LANES)), [0] * LANES))
        floats = ir.VectorType(FLOAT, LANES)
        found = cgutils.alloca_once_value(builder, LONG(0))
        with cgutils.for_range_slice(builder, LONG(0), count, LONG(LANES), inc=True) as (start, _):
            number = builder.add(first, builder.trunc(start, INT))
            step = builder.sitofp(builder.add(_splat(builder, number, LANES), numbers), floats)
            place = zeros
            for axis, stride in enumerate((INT(1), *strides)):
                at = _fma(builder, step, line[axis + 3], line[axis])
                cell = builder.fptosi(at, numbers.type)  # truncation is floor: rounding alone makes it negative
                for sign, end in (("<", last[axis]), (">", zeros)):
                    cell = builder.select(builder.icmp_signed(sign, cell, end), cell, end)
                _store(
                    builder, builder.fsub(at, builder.sitofp(cell, floats)), into, _row(builder, axis, length, start)
                )
                place = builder.add(place, builder.mul(cell, _splat(builder, stride, LANES)))
            inside = builder.icmp_signed(
                "<", numbers, _splat(builder, builder.trunc(builder.sub(count, start), INT), LANES)
            )
            place = builder.select(inside, place, _splat(builder, nowhere, LANES))
            _store(builder, place, places, start)
            for lane in range(LANES):  # the next one is written over one that is not lit: no branch to guess
                so_far, step = builder.load(found), builder.add(start, LONG(lane))
                builder.store(builder.trunc(step, INT), builder.gep(lit, [so_far]))
                cell = builder.zext(builder.load(builder.gep(places, [step])), LONG)
                occupied = builder.zext(builder.load(builder.gep(cells, [cell])), LONG)
                builder.store(builder.add(so_far, occupied), found)
        return builder.load(found)

    numbers = types.int32, types.intp, _sides, _strides
    return types.intp(cells, _line, *numbers, places, into, lit), generate


@intrinsic
def march(context, voxels, strides, places, into, lit, count, opaque):
    """The pixel (red, green, blue, mask) that a ray's `count` lit steps add up to, until less than `opaque` is left."""

    def generate(context, builder, signature, arguments):
        (lit,) = _data(context, builder, signature, arguments, 4)
        count, opaque = arguments[5:]
        total, light = (cgutils.alloca_once_value(builder, _splat(builder, FLOAT(x), 4)) for x in (0.0, 1.0))
        with cgutils.for_range(builder, count) as loop:  # near to far
            value = _value(context, builder, signature, arguments, builder.load(builder.gep(lit, [loop.index])))
            occupancy = builder.shuffle_vector(value, value, ir.Constant(ir.VectorType(INT, 4), [3] * 4))
            left = builder.load(light)  # transmittance: equation 3's product
            stop = builder.fmul(occupancy, left)  # equation 3
            one = builder.insert_element(value, FLOAT(1.0), INT(3))  # the mask is the sum of the probabilities
            builder.store(_fma(builder, stop, one, builder.load(total)), total)  # equation 4
            left = builder.fsub(left, builder.fmul(occupancy, left, flags=("contract",)), flags=("contract",))
            builder.store(left, light)  # what reaches the next step
            with builder.if_then(
                builder.fcmp_ordered("<", builder.extract_element(left, INT(0)), opaque), likely=False
            ):
                loop.do_break()
        return context.make_tuple(builder, signature.return_type, _elements(builder, builder.load(total)))

    return _four(voxels, _strides, places, into, lit, types.intp, types.float32), generate


@intrinsic
def interpolate(context, voxels, strides, places, into, lit, begin, end, values):
    """Fills `values`[4 begin : 4 end]: red, green, blue and occupancy at the steps `lit`[begin : end]."""

    def generate(context, builder, signature, arguments):
        lit, values = _data(context, builder, signature, arguments, 4, 7)
        begin, end = arguments[5:7]
        with cgutils.for_range(builder, end, begin) as loop:
            value = _value(context, builder, signature, arguments, builder.load(builder.gep(lit, [loop.index])))
            _store(builder, value, values, builder.mul(loop.index, LONG(4)))
        return context.get_dummy_value()

    return types.void(voxels, _strides, places, into, lit, types.intp, types.intp, values), generate


@intrinsic
def slopes(context, voxels, strides, places, into, step, weights):
    """The derivatives along u, v and w, at a step, of the values' sum with `weights` (4)."""

    def generate(context, builder, signature, arguments):
        corners, (fu, fv, fw) = _cell(context, builder, signature, arguments, arguments[4])
        weights = _vector(builder, cgutils.unpack_tuple(builder, arguments[5]))
        along = [builder.fsub(b, a) for a, b in zip(corners[:2], corners[2:], strict=True)]  # d/dw at both v
        near, far = (_fma(builder, fw, slope, a) for slope, a in zip(along, corners, strict=False))
        along_v = builder.fsub(far, near)
        low, high = _halves(builder, _fma(builder, fv, along_v, near))
        found = [builder.fsub(high, low)]  # d/du
        for slope in (along_v, _fma(builder, fv, builder.fsub(along[1], along[0]), along[0])):  # d/dv, d/dw
            low, high = _halves(builder, slope)
            found.append(_fma(builder, fu, builder.fsub(high, low), low))
        sums = []
        for slope in found:  # all four channels take part in each
            a, b, c, d = _elements(builder, builder.fmul(slope, weights))
            sums.append(builder.fadd(builder.fadd(a, b), builder.fadd(c, d)))  # in pairs: shorter chains
        return context.make_tuple(builder, signature.return_type, sums)

    return _three(voxels, _strides, places, into, types.intp, _four), generate


@intrinsic
def deposit(context, voxels, strides, places, into, step, values):
    """Adds `values` (4) to the corners of a step's cell, to each as much as it has of the place."""

    def generate(context, builder, signature, arguments):
        at, (fu, fv, fw) = _corners(context, builder, signature, arguments, arguments[4])
        parts = [_vector(builder, cgutils.unpack_tuple(builder, arguments[5]))]
        for fraction in (fw, fv, fu):  # trilinear's transpose: split along w, v and u in turn
            far = [builder.fmul(part, _splat(builder, fraction, 4)) for part in parts]
            parts = [
                piece for part, share in zip(parts, far, strict=True) for piece in (builder.fsub(part, share), share)
            ]
        # Voxel by voxel: a store of two would have to reach memory before the next step's load, which overlaps it.
        for pair, near, far in zip(at, parts[::2], parts[1::2], strict=True):
            for pointer, part in ((pair, near), (builder.gep(pair, [INT(4)]), far)):
                voxel = builder.bitcast(pointer, ir.VectorType(FLOAT, 4).as_pointer())
                builder.store(builder.fadd(builder.load(voxel, align=4), part), voxel, align=4)  # one thread a volume
        return context.get_dummy_value()

    return types.void(voxels, _strides, places, into, types.intp, _four), generate


def _value(context, builder, signature, arguments, step):
    """The four values at a step."""
    corners, (fu, fv, fw) = _cell(context, builder, signature, arguments, builder.zext(step, LONG))
    near, far = (_fma(builder, fw, builder.fsub(b, a), a) for a, b in zip(corners[:2], corners[2:], strict=True))
    low, high = _halves(builder, _fma(builder, fv, builder.fsub(far, near), near))
    return _fma(builder, fu, builder.fsub(high, low), low)


def _cell(context, builder, signature, arguments, step):
    """The pairs of corners (at v and w, v + 1, w + 1, both), eight numbers each, and the fractions splatted to fit."""
    at, (fu, fv, fw) = _corners(context, builder, signature, arguments, step)
    eight = ir.VectorType(FLOAT, 8).as_pointer()
    corners = [builder.load(builder.bitcast(pointer, eight), align=4) for pointer in at]
    return corners, (_splat(builder, fu, 4), _splat(builder, fv, 8), _splat(builder, fw, 8))


def _corners(context, builder, signature, arguments, step):
    """Pointers to a step's four pairs of corners, neighbours along u, and how far into the cell it is."""
    voxels, places, into = _data(context, builder, signature, arguments, 0, 2, 3)
    row, plane = cgutils.unpack_tuple(builder, arguments[1])
    length = _length(context, builder, signature, arguments, 3)
    place = builder.zext(builder.load(builder.gep(places, [step])), LONG)
    above = builder.add(place, plane)
    cells = place, builder.add(place, row), above, builder.add(above, row)
    at = [builder.gep(voxels, [builder.shl(cell, LONG(2))]) for cell in cells]
    return at, [builder.load(builder.gep(into, [_row(builder, axis, length, step)])) for axis in range(3)]


def _data(context, builder, signature, arguments, *which):
    """Pointers to what some arguments, which are arrays, hold."""
    return [context.make_array(signature.args[i])(context, builder, arguments[i]).data for i in which]


def _length(context, builder, signature, arguments, which, axis=1):
    array = context.make_array(signature.args[which])(context, builder, arguments[which])
    return builder.extract_value(array.shape, axis)


def _row(builder, axis, length, step):
    return builder.add(builder.mul(LONG(axis), length), step)


def _store(builder, vector, array, at):
    builder.store(vector, builder.bitcast(builder.gep(array, [at]), vector.type.as_pointer()), align=4)


def _fma(builder, a, b, c):
    return builder.fadd(builder.fmul(a, b, flags=("contract",)), c, flags=("contract",))  # fused if the CPU can


def _vector(builder, numbers):
    vector = ir.Constant(ir.VectorType(numbers[0].type, len(numbers)), ir.Undefined)  # all are set below
    for i, number in enumerate(numbers):
        vector = builder.insert_element(vector, number, INT(i))
    return vector


def _splat(builder, number, lanes):
    return _vector(builder, [number] * lanes)


def _halves(builder, vector):
    """The first and the last four of eight numbers."""
    nothing = ir.Constant(vector.type, ir.Undefined)
    places = ir.VectorType(INT, 4)
    return [builder.shuffle_vector(vector, nothing, ir.Constant(places, list(range(i, i + 4)))) for i in (0, 4)]


def _elements(builder, vector):
    return [builder.extract_element(vector, INT(i)) for i in range(4)]

"""Between a cell's eight corners, the four values of a voxel at once: what Numba does not vectorise by itself.

`voxels` are (P, 4) float32, contiguous; a cell is named by its lowest corner `p`, and `row` and `plane` are how many
voxels further its neighbours along v and w are; `into` is how far into the cell along u, v and w, in [0, 1).
"""

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

FLOAT = ir.FloatType()
FOUR = ir.VectorType(FLOAT, 4)  # a voxel in one 128-bit register
_three, _four = types.UniTuple(types.float32, 3), types.UniTuple(types.float32, 4)
_INDICES = (types.uintp, types.uintp, types.uintp, _three)  # p, row, plane: unsigned, no sign to check in indexing


@intrinsic
def sampled(context, voxels, p, row, plane, into):
    """The four values (red, green, blue, occupancy) at a place."""

    def generate(context, builder, signature, arguments):
        corners = [builder.load(at, align=4) for at in _corners(context, builder, signature, arguments)]
        fu, fv, fw = (_splat(builder, number) for number in _numbers(builder, arguments[4], 3))
        found, _, _, _ = _between(builder, corners, fu, fv, fw)  # LLVM drops the slopes, which nobody reads
        return _tuple(context, builder, signature, _elements(builder, found))

    return _four(voxels, *_INDICES), generate


@intrinsic
def slopes(context, voxels, p, row, plane, into, weights):
    """The derivatives along u, v and w of the values' sum with `weights` (4)."""

    def generate(context, builder, signature, arguments):
        corners = [builder.load(at, align=4) for at in _corners(context, builder, signature, arguments)]
        # Weights first, then one dot product an axis: all four channels take part in each derivative.
        fu, fv, fw = (_splat(builder, number) for number in _numbers(builder, arguments[4], 3))
        weights = _vector(builder, _numbers(builder, arguments[5], 4))
        _, *along = _between(builder, corners, fu, fv, fw)
        sums = []
        for slope in along:  # d/du, d/dv, d/dw
            a, b, c, d = _elements(builder, builder.fmul(slope, weights))
            sums.append(builder.fadd(builder.fadd(a, b), builder.fadd(c, d)))  # in pairs: shorter chains
        return _tuple(context, builder, signature, sums)

    return _three(voxels, *_INDICES, _four), generate


@intrinsic
def deposit(context, voxels, p, row, plane, into, values):
    """Adds `values` (4) to the corners, to each as much as it has of the place."""

    def generate(context, builder, signature, arguments):
        values = _vector(builder, _numbers(builder, arguments[5], 4))
        fu, fv, fw = (_splat(builder, number) for number in _numbers(builder, arguments[4], 3))
        parts = [values]  # trilinear's transpose: split along w, v and u in turn
        for f in (fw, fv, fu):
            split = []
            for part in parts:  # (w), (w, v), then (w, v, u): the corners' order
                far = builder.fmul(part, f)
                split += [builder.fsub(part, far), far]  # near and far sum to the part
            parts = split
        for at, part in zip(_corners(context, builder, signature, arguments), parts, strict=True):
            builder.store(builder.fadd(builder.load(at, align=4), part), at, align=4)  # one thread a volume: not atomic
        return context.get_dummy_value()

    return types.void(voxels, *_INDICES, _four), generate


def _corners(context, builder, signature, arguments):
    """Pointers to the eight corners' values: along u first, along w last."""
    voxels, p, row, plane = arguments[:4]
    data = context.make_array(signature.args[0])(context, builder, voxels).data  # (P 4,) floats
    one = ir.Constant(p.type, 1)
    found = []
    for along_w in (p, builder.add(p, plane)):  # nested: corner 4 dw + 2 dv + du
        for along_v in (along_w, builder.add(along_w, row)):
            for at in (along_v, builder.add(along_v, one)):
                found.append(builder.bitcast(builder.gep(data, [builder.shl(at, ir.Constant(p.type, 2))]), _POINTER))
    return found


_POINTER = FOUR.as_pointer()


def _between(builder, corners, fu, fv, fw):
    """The value between eight corners, and its derivatives along u, v and w."""
    along_u = [builder.fsub(corners[i + 1], corners[i]) for i in (0, 2, 4, 6)]  # the four edges along u
    lines = [_fma(builder, fu, slope, corners[2 * i]) for i, slope in enumerate(along_u)]  # linear on each edge
    along_v = [builder.fsub(lines[1], lines[0]), builder.fsub(lines[3], lines[2])]
    faces = [_fma(builder, fv, along_v[0], lines[0]), _fma(builder, fv, along_v[1], lines[2])]
    along_w = builder.fsub(faces[1], faces[0])  # d/dw
    slope_v = _fma(builder, fw, builder.fsub(along_v[1], along_v[0]), along_v[0])
    near = _fma(builder, fv, builder.fsub(along_u[1], along_u[0]), along_u[0])
    far = _fma(builder, fv, builder.fsub(along_u[3], along_u[2]), along_u[2])
    slope_u = _fma(builder, fw, builder.fsub(far, near), near)  # d/du
    return _fma(builder, fw, along_w, faces[0]), slope_u, slope_v, along_w


def _fma(builder, a, b, c):
    return builder.fadd(builder.fmul(a, b, flags=("contract",)), c, flags=("contract",))  # fused if the CPU can


def _numbers(builder, values, count):
    return [builder.extract_value(values, i) for i in range(count)]


def _vector(builder, numbers):
    vector = ir.Constant(FOUR, ir.Undefined)  # all four are set below
    for i, number in enumerate(numbers):
        vector = builder.insert_element(vector, number, ir.Constant(ir.IntType(32), i))
    return vector


def _splat(builder, number):
    return _vector(builder, [number] * 4)


def _elements(builder, vector):
    return [builder.extract_element(vector, ir.Constant(ir.IntType(32), i)) for i in range(4)]


def _tuple(context, builder, signature, numbers):
    return context.make_tuple(builder, signature.return_type, numbers)

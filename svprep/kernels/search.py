"""Facing, the flat scan and the search of dual boxes and normal cones, compiled.

Everything that decides a side of a plane lies in this file. `_side` decides; float32
tells of a plane, an edge or a node only what its error bound shows `_side` to say.

The two trees share their shape: eight children a node, breadth-first, level by level,
no pointers. A node, and a leaf of eight edges, is a block of 8 numbers for each of 8
lanes (128 bytes), which the processor tests at once:

    lane      0     1         7
    number 0  cx    cx  ...   cx      dual box: centre and half extents
           1  cy    cy        cy
           ...
           7  ew    ew        ew

Numbers are int16, in units of 1 / `UNIT` (the fourth of a dual point: 2 / `UNIT`).
Block b of a level describes the blocks 8 b .. 8 b + 7 of the next one; the last
level describes leaves. A block is read where the search happens to go, so the
memory is asked for it some blocks ahead (`_prefetch`).

The margins: 2e-6 of the light's terms for a dozen roundings of float32, half a unit
for an edge's int16, and what float64 itself may lose.
"""

from __future__ import annotations

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.extending import intrinsic

UNIT = 32000.0
_PER_UNIT, _PER_TWO_UNITS = np.float32(1.0 / UNIT), np.float32(2.0 / UNIT)
_LANES = 8
_AHEAD = np.uint64(16)
"""Blocks, or records, between asking the memory for one and looking at it. Asking for all
at once is no better than not asking: the processor keeps track of a few only."""
_F32X8 = ir.VectorType(ir.FloatType(), _LANES)
_I32, _I16, _I8 = ir.IntType(32), ir.IntType(16), ir.IntType(8)
_I16X8 = ir.VectorType(_I16, _LANES)
_I32X8 = ir.VectorType(_I32, _LANES)


def _block(context, builder, array_type, array, offset):
    """Return the 8 vectors of 8 int16 that begin at ``array[offset]``, as floats."""
    data = context.make_array(array_type)(context, builder, array).data
    first = builder.gep(data, [offset])
    rows = []
    for k in range(8):
        row = builder.gep(first, [ir.Constant(ir.IntType(64), k * _LANES)])
        vector = builder.load(builder.bitcast(row, _I16X8.as_pointer()))
        vector.align = 2
        rows.append(builder.sitofp(builder.sext(vector, _I32X8), _F32X8))
    return rows


def _splat(builder, value):
    """Return a vector whose 8 lanes are all `value`."""
    one = builder.insert_element(ir.Constant(_F32X8, ir.Undefined), value, _I32(0))
    zeros = ir.Constant(ir.VectorType(_I32, _LANES), [0] * _LANES)
    return builder.shuffle_vector(one, ir.Constant(_F32X8, ir.Undefined), zeros)


def _dot(builder, vectors, others):
    total = builder.fmul(vectors[0], others[0])
    for a, b in zip(vectors[1:], others[1:], strict=True):
        total = builder.fadd(total, builder.fmul(a, b))
    return total


def _unary(builder, name, vector):
    """Return ``llvm.name`` of each lane: fabs or sqrt."""
    function_type = ir.FunctionType(_F32X8, [_F32X8])
    function = cgutils.get_or_insert_function(
        builder.module, function_type, f"llvm.{name}.v{_LANES}f32"
    )
    return builder.call(function, [vector])


def _bits(builder, lanes):
    """Return a comparison's 8 lanes as the 8 low bits of a uint32."""
    return builder.zext(builder.bitcast(lanes, _I8), _I32)


_F = types.float32
_SLACK = np.float32(2e-6)
"""Of the sum ``|x| + |y| + |z| + 2 w`` of a light: more than float32 rounds in a test."""
_LEAST = np.float32(1e-30)
"""More than float32 loses where it underflows."""
_STEP = np.uint64(2048)
"""Records at a time: those that are left open are still at hand."""


@intrinsic
def _open_boxes(typing, blocks, offset, lx, ly, lz, lw, slack):
    """Return, as bits, the boxes that the hyperplane of the light meets."""
    signature = types.uint32(blocks, types.uint64, _F, _F, _F, _F, _F)

    def generate(context, builder, signature, arguments):
        array, offset, *numbers = arguments
        rows = _block(context, builder, signature.args[0], array, offset)
        light = [_splat(builder, value) for value in numbers[:4]]
        reach = [_unary(builder, "fabs", value) for value in light]
        middle = _unary(builder, "fabs", _dot(builder, rows[:4], light))
        half = builder.fadd(_dot(builder, rows[4:], reach), _splat(builder, numbers[4]))
        # Ordered: a number that overflowed decides nothing.
        decided = builder.fcmp_ordered(">", middle, half)
        return builder.xor(_bits(builder, decided), _I32(0xFF))

    return signature, generate


@intrinsic
def _open_cones(typing, blocks, offset, lx, ly, lz, lw, slack):
    """Return, as bits, the spheres with cones that may hold both facings.

    With D from the sphere's centre to the light, a = axis . D and b the length of
    D across the axis, ``|a| cos h - b sin h > r`` says that every plane through
    the sphere with a normal in the cone has the light on one side.
    """
    signature = types.uint32(blocks, types.uint64, _F, _F, _F, _F, _F)

    def generate(context, builder, signature, arguments):
        array, offset, *numbers = arguments
        lx, ly, lz, w, slack = (_splat(builder, value) for value in numbers)

        def constant(value):
            return ir.Constant(_F32X8, [value] * _LANES)

        rows = _block(context, builder, signature.args[0], array, offset)
        unit = constant(1.0 / UNIT)
        x, y, z, radius, *axis, sine = (builder.fmul(row, unit) for row in rows)
        towards = [
            builder.fsub(light, builder.fmul(w, centre))
            for light, centre in ((lx, x), (ly, y), (lz, z))
        ]
        length2 = _dot(builder, towards, towards)
        # The axis, as it is rounded, is not quite of length 1.
        along = builder.fdiv(
            _dot(builder, towards, axis), _unary(builder, "sqrt", _dot(builder, axis, axis))
        )
        across2 = builder.fsub(length2, builder.fmul(along, along))
        # What the difference may have lost; so it is above zero as well.
        across2 = builder.fadd(across2, builder.fmul(length2, constant(2e-6)))
        across = _unary(builder, "sqrt", across2)
        cosine2 = builder.fsub(constant(1.0), builder.fmul(sine, sine))
        cosine = builder.fsub(_unary(builder, "sqrt", cosine2), constant(1e-6))
        least = builder.fsub(
            builder.fmul(_unary(builder, "fabs", along), cosine), builder.fmul(across, sine)
        )
        most = builder.fadd(builder.fmul(radius, w), slack)
        decided = builder.fcmp_ordered(">", least, most)
        return builder.xor(_bits(builder, decided), _I32(0xFF))

    return signature, generate


@intrinsic
def _edge_sides(typing, blocks, offset, lx, ly, lz, lw, slack):
    """Return 4 x 8 bits: left surely +1, left surely -1, right +1, right -1."""
    signature = types.uint32(blocks, types.uint64, _F, _F, _F, _F, _F)

    def generate(context, builder, signature, arguments):
        array, offset, *numbers = arguments
        rows = _block(context, builder, signature.args[0], array, offset)
        light = [_splat(builder, value) for value in numbers[:4]]
        slack = _splat(builder, numbers[4])
        result = _I32(0)
        for k, value in enumerate((_dot(builder, rows[:4], light), _dot(builder, rows[4:], light))):
            above = _bits(builder, builder.fcmp_ordered(">", value, slack))
            below = _bits(builder, builder.fcmp_ordered("<", value, builder.fneg(slack)))
            result = builder.or_(result, builder.shl(above, _I32(16 * k)))
            result = builder.or_(result, builder.shl(below, _I32(16 * k + 8)))
        return result

    return signature, generate


@intrinsic
def _prefetch(typing, array, offset):
    """Ask the memory for the line that holds ``array[offset]``."""
    signature = types.void(array, types.uint64)

    def generate(context, builder, signature, arguments):
        array, offset = arguments
        data = context.make_array(signature.args[0])(context, builder, array).data
        pointer_type = _I8.as_pointer()
        function = cgutils.get_or_insert_function(
            builder.module,
            ir.FunctionType(ir.VoidType(), [pointer_type, _I32, _I32, _I32]),
            "llvm.prefetch.p0i8",
        )
        pointer = builder.bitcast(builder.gep(data, [offset]), pointer_type)
        # To read, to keep in every cache, data.
        builder.call(function, [pointer, _I32(0), _I32(3), _I32(1)])
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def _lowest_bit(typing, mask):
    """Return the number of the lowest bit that is set in a uint32 that is not 0."""
    signature = types.uint32(types.uint32)

    def generate(context, builder, signature, arguments):
        return builder.cttz(arguments[0], ir.Constant(ir.IntType(1), 1))

    return signature, generate


_helper = njit(nogil=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)


@_helper
def _side(planes, i, x, y, z, w):
    """Return the facing of plane record i: the only place that decides it."""
    value = planes[i, 0] * x + planes[i, 1] * y + planes[i, 2] * z
    value += planes[i, 3] * w
    return np.int8(value > 0.0) - np.int8(value < 0.0)


@_helper
def _direction(x, y, z, w):
    """Return x, y, z in float32; of a direction scaled, so that nothing underflows."""
    scale = 1.0 / max(abs(x), abs(y), abs(z)) if w == 0.0 else 1.0
    return np.float32(x * scale), np.float32(y * scale), np.float32(z * scale)


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def facing_of_planes(planes, x, y, z, w, s):
    """Write the facing of every plane record, +1, 0 or -1.

    ``planes (n, 4) float64``, ``s (n,) int8``; w is 0 or 1.
    """
    for i in range(np.uint64(len(s))):
        s[i] = _side(planes, i, x, y, z, w)


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def counted_facing(planes, units, x, y, z, w, floor, begin, end, s):
    """Write ``s[i] = max(facing, floor[i])`` of the records in ranges of them.

    Parameters
    ----------
    planes : ndarray
        ``(n, 4) float64``
    units : ndarray
        ``(4, n) float32``: the same, divided by the normal's length, one row after
        another: half the bytes, which are what this waits for. Where float32 leaves
        the side open, `_side` decides it.
    floor : ndarray
        ``(n,) int8``: 0 where the closed volume counts only faces that see the
        light, else -1.
    begin, end : ndarray
        ``(k,) int64``: the ranges.
    s : ndarray
        ``int8``
    """
    lx, ly, lz = _direction(x, y, z, w)
    reach = abs(lx) + abs(ly) + abs(lz)
    for k in range(len(begin)):
        for first in range(np.uint64(begin[k]), np.uint64(end[k]), _STEP):
            last = min(np.uint64(end[k]), first + _STEP)
            n_open = np.int64(0)
            if w == 0.0:  # without a word of d: what is not read costs nothing
                slack = _SLACK * reach
                for i in range(first, last):
                    value = units[0, i] * lx + units[1, i] * ly + units[2, i] * lz
                    is_open = np.int8(not (abs(value) > slack))
                    s[i] = np.int8(value > slack) + np.int8(value < -slack) * floor[i] + 2 * is_open
                    n_open += is_open
            else:
                for i in range(first, last):
                    d = units[3, i]
                    value = units[0, i] * lx + units[1, i] * ly + units[2, i] * lz + d
                    slack = _SLACK * (reach + abs(d)) + _LEAST
                    is_open = np.int8(not (abs(value) > slack))
                    s[i] = np.int8(value > slack) + np.int8(value < -slack) * floor[i] + 2 * is_open
                    n_open += is_open
            if n_open > 0:
                for i in range(first, last):
                    if s[i] == 2:
                        s[i] = max(_side(planes, i, x, y, z, w), floor[i])


@_helper
def _prefetch_block(blocks, number):
    """Ask the memory for a block: two lines."""
    _prefetch(blocks, number << np.uint64(6))
    _prefetch(blocks, (number << np.uint64(6)) + np.uint64(32))


@_helper
def _prefetch_leaf(leaves, order, first_leaf, first_pair, number):
    """Ask the memory for a leaf and the ids of its edges."""
    _prefetch_block(leaves, first_leaf + number)
    _prefetch(order, first_pair + (number << np.uint64(3)))


@_helper
def _descend(
    is_cones, blocks, first_block, n_leaves, lx, ly, lz, lw, slack, frontier, following, sizes,
):  # fmt: skip
    """Return the leaves that the light may divide: their number, and nodes tested.

    `frontier` and `following` are scratch of more than ``n_leaves`` numbers; the
    leaves end up in the first of them, in the order of the tree. `sizes` is scratch.
    """
    bx, by, bz, bw = lx * _PER_UNIT, ly * _PER_UNIT, lz * _PER_UNIT, lw * _PER_TWO_UNITS
    sizes[0] = n_leaves
    n_levels = np.uint64(0)
    while n_levels == 0 or sizes[n_levels] > np.uint64(1):
        sizes[n_levels + np.uint64(1)] = (sizes[n_levels] + np.uint64(7)) >> np.uint64(3)
        n_levels += np.uint64(1)
    base = np.uint64(first_block)
    frontier[0] = 0
    n_open = np.uint64(1)
    n_tested = np.uint64(0)
    for up in range(n_levels):
        n_below = sizes[n_levels - np.uint64(1) - up]
        n_next = np.uint64(0)
        for q in range(min(_AHEAD, n_open)):
            _prefetch_block(blocks, base + np.uint64(frontier[q]))
        for q in range(n_open):
            if q + _AHEAD < n_open:
                _prefetch_block(blocks, base + np.uint64(frontier[q + _AHEAD]))
            number = np.uint64(frontier[q])
            offset = (base + number) << np.uint64(6)
            if is_cones:
                mask = _open_cones(blocks, offset, lx, ly, lz, lw, slack)
            else:
                mask = _open_boxes(blocks, offset, bx, by, bz, bw, slack)
            first = number << np.uint64(3)
            n_lanes = min(np.uint64(8), n_below - first)
            n_tested += n_lanes
            mask &= np.uint32((np.uint32(1) << np.uint32(n_lanes)) - np.uint32(1))
            while mask != np.uint32(0):
                child = np.uint32(first) + _lowest_bit(mask)
                mask &= mask - np.uint32(1)
                following[n_next] = child
                n_next += np.uint64(1)
        base += sizes[n_levels - up]
        n_open = n_next
        for q in range(n_open):
            frontier[q] = following[q]
    return n_open, n_tested


@_helper
def _sort(keys, other, begin, end, count):
    """Sort ``keys[begin:end]``, all different, by radix; `other` is scratch as long."""
    n = end - begin
    bits, n_digits = (np.uint64(11), 2048) if n > np.uint64(1024) else (np.uint64(7), 128)
    digit_mask = np.uint64(n_digits - 1)
    if n <= 24:
        for i in range(begin + 1, end):
            key = keys[i]
            j = i
            while j > begin and keys[j - 1] > key:
                keys[j] = keys[j - 1]
                j -= 1
            keys[j] = key
        return
    low = keys[begin]
    high = low
    for i in range(begin, end):
        low = min(low, keys[i])
        high = max(high, keys[i])
    # The three low bits hold the multiplicity, which needs no order.
    low &= ~np.uint64(7)
    shift = np.uint64(3)
    while (high - low) >> shift != np.uint64(0):
        for digit in range(n_digits):
            count[digit] = 0
        for i in range(begin, end):
            count[((keys[i] - low) >> shift) & digit_mask] += 1
        at = np.uint64(0)
        for digit in range(n_digits):
            here = count[digit]
            count[digit] = at
            at += here
        for i in range(begin, end):
            digit = ((keys[i] - low) >> shift) & digit_mask
            other[count[digit]] = keys[i]
            count[digit] += 1
        for i in range(n):
            keys[begin + i] = other[i]
        shift += bits


@_helper
def _multiplicity(planes, floor, left, right, light):
    """Return m of the record between two plane records; ``len(planes)`` is no face."""
    x, y, z, w = light
    n = np.uint64(len(planes))
    m = np.int64(0)
    if left < n:
        m += max(_side(planes, left, x, y, z, w), floor[left])
    if right < n:
        m -= max(_side(planes, right, x, y, z, w), floor[right])
    return m


@_helper
def _test_leaves(
    leaves, order, refs, first_leaf, first_pair, n_pairs, planes, floor, floor_of_all,
    light, lx, ly, lz, lw, slack, frontier, n_open, keys, n_keys,
):  # fmt: skip
    """Append the key of every silhouette edge in the leaves that are open.

    `floor_of_all` is the floor of every record here, or 1 where they differ.
    Returns the number of keys, and of edges tested.
    """
    bx, by, bz, bw = lx * _PER_UNIT, ly * _PER_UNIT, lz * _PER_UNIT, lw * _PER_TWO_UNITS
    n_tested = np.uint64(0)
    for q in range(min(_AHEAD, n_open)):
        _prefetch_leaf(leaves, order, first_leaf, first_pair, np.uint64(frontier[q]))
    for q in range(n_open):
        if q + _AHEAD < n_open:
            ahead = np.uint64(frontier[q + _AHEAD])
            _prefetch_leaf(leaves, order, first_leaf, first_pair, ahead)
        first = np.uint64(frontier[q]) << np.uint64(3)
        offset = (np.uint64(first_leaf) + np.uint64(frontier[q])) << np.uint64(6)
        sides = _edge_sides(leaves, offset, bx, by, bz, bw, slack)
        n_lanes = min(np.uint64(8), np.uint64(n_pairs) - first)
        n_tested += n_lanes
        # Both surely +1, or both surely -1.
        equal = sides & (sides >> np.uint32(16))
        equal |= (sides >> np.uint32(8)) & (sides >> np.uint32(24))
        mask = ~equal & ((np.uint32(1) << np.uint32(n_lanes)) - np.uint32(1))
        while mask != np.uint32(0):
            lane = _lowest_bit(mask)
            mask &= mask - np.uint32(1)
            at = np.uint64(first_pair) + first + np.uint64(lane)
            bits = (sides >> lane) & np.uint32(0x01010101)
            least = np.int64(floor_of_all if floor_of_all <= 0 else floor[refs[at, 0]])
            if bits == np.uint32(0x01000001):
                m = np.int64(1) - least
            elif bits == np.uint32(0x00010100):
                m = least - np.int64(1)
            else:
                left, right = np.uint64(refs[at, 0]), np.uint64(refs[at, 1])
                m = _multiplicity(planes, floor, left, right, light)
            keys[n_keys] = (np.uint64(order[at]) << np.uint64(3)) | np.uint64(m + 2)
            n_keys += np.uint64(m != 0)
    return n_keys, n_tested


@_helper
def _merge_always(
    always, refs, first, last, planes, floor, light, keys, other, begin, end,
):  # fmt: skip
    """Merge the always-on records ``first .. last - 1`` into the sorted keys."""
    if first == last:
        return end
    n = end - begin
    for i in range(n):
        other[i] = keys[begin + i]
    i = np.uint64(0)
    at = begin
    for k in range(first, last):
        # Of the two numbers one may stand for no face: the smaller never does.
        soon = min(k + _AHEAD, last - np.uint64(1))
        _prefetch(planes, np.uint64(min(refs[soon, 0], refs[soon, 1])) << np.uint64(2))
        m = _multiplicity(planes, floor, np.uint64(refs[k, 0]), np.uint64(refs[k, 1]), light)
        key = (np.uint64(always[k]) << np.uint64(3)) | np.uint64(m + 2)
        while i < n and other[i] < key:
            keys[at] = other[i]
            at += np.uint64(1)
            i += np.uint64(1)
        keys[at] = key
        at += np.uint64(m != 0)
    while i < n:
        keys[at] = other[i]
        at += np.uint64(1)
        i += np.uint64(1)
    return at


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def search_trees(
    is_cones, trees, frames, starts, blocks, leaves, order, refs, always, always_refs,
    planes, floor, floor_of_tree, x, y, z, w, keys, other, frontiers, key_end, tested,
):  # fmt: skip
    """Write the silhouette of each object in `trees` as sorted keys.

    Parameters
    ----------
    is_cones : bool
        Whether `blocks` hold spheres with normal cones, not dual boxes.
    trees : ndarray
        ``(k,) int64``: rows of `frames` and `starts`, ascending.
    frames : ndarray
        ``(n, 4) float32``: each object's centre and radius [m].
    starts : ndarray
        ``(n + 1, 4) int64``: where its pairs, its blocks, its leaves and its
        always-on records begin.
    blocks, leaves : ndarray
        ``int16``, 64 numbers a block; leaves hold the dual points of 8 edges.
    order, refs : ndarray
        ``(n_pairs,) uint32``, ``(n_pairs, 2) uint32``: the record, and the plane
        records left and right of it, of each edge in the order of the tree.
    always, always_refs : ndarray
        The same of the border and split records, which no tree holds.
    planes, floor : ndarray
        As `counted_facing` takes them.
    floor_of_tree : ndarray
        ``(n,) int8``: the floor of all its planes, or 1 where they differ.
    keys : ndarray
        ``uint64``, long enough for every record: ``8 * record + m + 2``.
    other, frontiers : ndarray
        Scratch: ``uint64`` for every record of an object, and ``(2, n) uint32`` for
        more than its leaves.
    key_end : ndarray
        ``(k,) int64``: where the keys of each object end.
    tested : ndarray
        ``(2,) int64``: edges and nodes tested, added up.
    """
    light = (x, y, z, w)
    frontier, following = frontiers[0], frontiers[1]
    count = np.empty(2048, np.uint64)
    n_keys = np.uint64(0)
    for k in range(len(trees)):
        t = trees[k]
        # The light in the object's frame, where every dual point has |p| <= 1, |d| <= 1.5.
        cx, cy, cz = np.float64(frames[t, 0]), np.float64(frames[t, 1]), np.float64(frames[t, 2])
        if w == 0.0:
            scale = 1.0 / max(abs(x), abs(y), abs(z))
            lx, ly, lz = _direction(x, y, z, w)
        else:
            scale = 1.0 / np.float64(frames[t, 3])
            lx = np.float32((x - cx) * scale)
            ly = np.float32((y - cy) * scale)
            lz = np.float32((z - cz) * scale)
        lw = np.float32(w)
        # float32: at most 12 roundings of sums below this one. float64: what `_side` loses.
        reach = abs(lx) + abs(ly) + abs(lz) + 2.0 * lw
        far = abs(x) + abs(y) + abs(z) + w * (abs(cx) + abs(cy) + abs(cz) + 3.0 * frames[t, 3])
        slack = np.float32(_SLACK * reach + 2e-15 * far * scale) + _LEAST
        # Half a unit of each number of a leaf: it is rounded to the nearest.
        leaf_slack = slack + np.float32(0.51 / UNIT) * reach
        first_pair, first_leaf = np.uint64(starts[t, 0]), np.uint64(starts[t, 2])
        n_open, n_nodes = _descend(
            is_cones, blocks, starts[t, 1], np.uint64(starts[t + 1, 2]) - first_leaf,
            lx, ly, lz, lw, slack, frontier, following, count,
        )  # fmt: skip
        begin = n_keys
        n_keys, n_edges = _test_leaves(
            leaves, order, refs, first_leaf, first_pair, starts[t + 1, 0] - starts[t, 0],
            planes, floor, floor_of_tree[t], light, lx, ly, lz, lw, leaf_slack,
            frontier, n_open, keys, n_keys,
        )  # fmt: skip
        _sort(keys, other, begin, n_keys, count)
        n_keys = _merge_always(
            always, always_refs, np.uint64(starts[t, 3]), np.uint64(starts[t + 1, 3]),
            planes, floor, light, keys, other, begin, n_keys,
        )  # fmt: skip
        n_edges += np.uint64(starts[t + 1, 3] - starts[t, 3])
        key_end[k] = n_keys
        tested[0] += np.int64(n_edges)
        tested[1] += np.int64(n_nodes)

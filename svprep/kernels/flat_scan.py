"""The flat scan: the multiplicity of one record after another, then those not zero.

Two passes, so that threads need not wait for each other's counts and each row is
written once, in its place: `multiplicities` streams the records and counts,
`compress` writes ids and multiplicities of those that are left.

Indices are unsigned: signed ones could count from the end, which costs a test each.
"""

from __future__ import annotations

import numpy as np
from llvmlite import binding, ir
from numba import config, njit, types
from numba.core import cgutils
from numba.extending import intrinsic

_STEP = np.uint64(4096)
_LOW = np.uint64(0xFFFFFFFF)
_WIDTH = 16


def _can_pack() -> bool:
    """Whether compiled code may use the instructions of `_pack` (AVX-512 VBMI2).

    Not if Numba compiles for another processor than this one, or without AVX, which it
    leaves out by itself on some virtual machines.
    """
    if config.CPU_NAME or config.CPU_FEATURES or not config.ENABLE_AVX:
        return False
    features = binding.get_host_cpu_features()
    return all(features.get(name) for name in ("avx512f", "avx512vl", "avx512vbmi2"))


_CAN_PACK = _can_pack()


@intrinsic
def _pack(typing, record, r, m, i, edge, multiplicity, n):
    """Append those of 16 records whose m is not zero; return the next free row.

    Reads ``record[r : r + 16]``, ``m[i : i + 16]``; writes 16 rows from n on, of which
    only the first ones hold something.
    """
    u64 = types.uint64
    signature = u64(record, u64, m, u64, edge, multiplicity, u64)

    def generate(context, builder, signature, arguments):
        def at(array, offset, element):
            """Return a pointer to 16 elements of an argument."""
            array_type = signature.args[array]
            data = context.make_array(array_type)(context, builder, arguments[array]).data
            return builder.bitcast(
                builder.gep(data, [arguments[offset]]),
                ir.VectorType(element, _WIDTH).as_pointer(),
            )

        i8, i32 = ir.IntType(8), ir.IntType(32)
        values = builder.load(at(2, 3, i8), align=1)
        is_kept = builder.icmp_signed("!=", values, ir.Constant(values.type, [0] * _WIDTH))
        ids = builder.load(at(0, 1, i32), align=4)
        for vector, array, name in ((ids, 4, "v16i32"), (values, 5, "v16i8")):
            packed = builder.call(
                cgutils.get_or_insert_function(
                    builder.module,
                    ir.FunctionType(vector.type, [vector.type, vector.type, is_kept.type]),
                    f"llvm.x86.avx512.mask.compress.{name}",
                ),
                [vector, ir.Constant(vector.type, ir.Undefined), is_kept],
            )
            bits = vector.type.element.width
            builder.store(packed, at(array, 6, vector.type.element), align=bits // 8)
        kept = builder.ctpop(builder.bitcast(is_kept, ir.IntType(_WIDTH)))
        return builder.add(arguments[6], builder.zext(kept, ir.IntType(64)))

    return signature, generate


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def multiplicities(sides, s, begin, end, to, m):
    """Write ``m = s[left] - s[right]`` of ranges of records; return how many are not 0.

    Parameters
    ----------
    sides : ndarray
        ``(n,) uint64``: the plane record on the left, and 2^32 times that on the
        right; of a missing face, one with s = 0.
    s : ndarray
        ``(n_planes + 1,) int8``: counted facing.
    begin, end, to : ndarray
        ``(k,) int64``: ranges of records, and where in `m` they go.
    m : ndarray
        ``int8``
    """
    n = np.int64(0)
    for k in range(len(begin)):
        shift = np.uint64(to[k] - begin[k])
        for first in range(np.uint64(begin[k]), np.uint64(end[k]), _STEP):
            last = min(np.uint64(end[k]), first + _STEP)
            for r in range(first, last):
                both = sides[r]
                m[r + shift] = s[both & _LOW] - s[both >> np.uint64(32)]
            # Apart, because this loop does many at a time.
            for r in range(first + shift, last + shift):
                n += m[r] != 0
    return n


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def compress(
    record, m, begin, end, to, keys, key_begin, key_end, first, last, begin_at, end_at,
    at, n_rows, edge, multiplicity, start,
):  # fmt: skip
    """Write the silhouette of a chunk of objects into its place.

    The chunk is the objects ``first .. last - 1``, of which the first may begin late, at
    record `begin_at`, and the last end early, at `end_at`: threads share one large
    object. An object has records to scan, or keys that a search left: one of the two is
    empty.

    Parameters
    ----------
    record : ndarray
        ``(n,) uint32``: ids of the records.
    m : ndarray
        ``int8``: what `multiplicities` wrote.
    begin, end, to : ndarray
        ``(k,) int64``: each object's records, and where in `m` they are.
    first, last, begin_at, end_at : int
        The chunk.
    keys : ndarray
        ``uint64``: ``8 * record + m + 2``, sorted.
    key_begin, key_end : ndarray
        ``(k,) int64``
    at, n_rows : int
        Where the chunk's first row goes, and how many rows it has.
    edge, multiplicity : ndarray
        ``uint32``, ``int8``: written from row `at` on, `n_rows` of them.
    start : ndarray
        ``(k,) int64``: the first row of each object that begins here, written.
    """
    n = np.uint64(at)
    n_end = np.uint64(at + n_rows)
    for k in range(first, last):
        r = np.uint64(begin_at if k == first else begin[k])
        stop = np.uint64(end_at if k == last - 1 else end[k])
        shift = np.uint64(to[k] - begin[k])
        if r == np.uint64(begin[k]):
            start[k] = n
        if _CAN_PACK:
            while r + np.uint64(_WIDTH) <= stop and n + np.uint64(_WIDTH) <= n_end:
                n = _pack(record, r, m, r + shift, edge, multiplicity, n)
                r += np.uint64(_WIDTH)
        n_left = n_end - n
        if n_left > stop - r:
            # Without a branch: a zero is written too, and overwritten by the next row,
            # which there is.
            while r < stop:
                value = m[r + shift]
                edge[n] = record[r]
                multiplicity[n] = value
                n += np.uint64(value != 0)
                r += np.uint64(1)
        # Few rows are left for many records: eight zeros at a time.
        is_sparse = np.uint64(8) * n_left < stop - r
        while r < stop and n < n_end:
            if is_sparse and r + np.uint64(8) <= stop:
                i = r + shift
                some = m[i] | m[i + np.uint64(1)] | m[i + np.uint64(2)] | m[i + np.uint64(3)]
                some |= m[i + np.uint64(4)] | m[i + np.uint64(5)]
                some |= m[i + np.uint64(6)] | m[i + np.uint64(7)]
                if some == 0:
                    r += np.uint64(8)
                    continue
            value = m[r + shift]
            edge[n] = record[r]
            multiplicity[n] = value
            n += np.uint64(value != 0)
            r += np.uint64(1)
        for i in range(np.uint64(key_begin[k]), np.uint64(key_end[k])):
            edge[n] = np.uint32(keys[i] >> np.uint64(3))
            multiplicity[n] = np.int8(np.int64(keys[i] & np.uint64(7)) - 2)
            n += np.uint64(1)

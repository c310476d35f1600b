"""Compiled loops of Hamming distances in bit slices: a word holds one bit of 64 descriptors.

The distance of a and b is ones(a) + ones(b) - 2 ones(a & b), and the last counts only those bits of b at which a has
one: half of them. They are added 512 descriptors at a time by carry-save adders, whose words hold one binary digit of
64 sums, and minima are found digit by digit. That takes four instructions of AVX2 for a pair, where population counts
take a dozen; where AVX-512 counts bits itself, they take two.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled, disjoint, inlined

U64 = NDArray[np.uint64]
I64 = NDArray[np.int64]
U16 = NDArray[np.uint16]

#: Words of a slice, and the descriptors whose bits they hold: what is compared at a time.
LANES = 8
COLUMNS = 64 * LANES
#: Binary digits of a distance, and the longest descriptor that they can count, in bits.
DIGITS = 10
LONGEST = (1 << DIGITS) - 1
#: Slices that one pass of the adders takes.
GROUP = 16
#: Where in the working memory which digits begin: of the sums, of ones in the columns, of distances, of column minima.
SUMS, OWN, FAR, BEST = 0, DIGITS * LANES, 2 * DIGITS * LANES, 3 * DIGITS * LANES
#: Columns that there are, those nearer than their best so far, and those nearer than the row's.
VALID, LESS, CLOSER = (4 * DIGITS) * LANES, (4 * DIGITS + 1) * LANES, (4 * DIGITS + 2) * LANES
MEMORY = (4 * DIGITS + 3) * LANES
LARGEST = np.uint64(0xFFFFFFFFFFFFFFFF)
ZERO, ONE = np.uint64(0), np.uint64(1)


@compiled
def slice_bits(descriptors: U64, slices: U64) -> None:
    """Turn (M, W) words into `slices` (blocks, (64 W + 1) LANES): bit c of a slice's word l is of descriptor 64 l + c.

    The last slice of each block stays 0.
    """
    count, width = descriptors.shape
    square = np.empty(64, np.uint64)
    for first in range(0, count, 64):
        block, lane = first // COLUMNS, first % COLUMNS // 64
        for word in range(width):
            for k in range(64):
                square[k] = descriptors[first + k, word] if first + k < count else ZERO
            # Quarters of 32, 16, ... 1 bits change places: the square is transposed.
            half, mask = 32, np.uint64(0x00000000FFFFFFFF)
            while half > 0:
                shift = np.uint64(half)
                for start in range(0, 64, 2 * half):
                    for k in range(start, start + half):
                        moved = ((square[k] >> shift) ^ square[k + half]) & mask
                        square[k] ^= moved << shift
                        square[k + half] ^= moved
                half //= 2
                mask ^= mask << np.uint64(half)
            for k in range(64):
                slices[block, (64 * word + k) * LANES + lane] = square[k]


@inlined
def _sum(a: np.uint64, b: np.uint64, c: np.uint64) -> np.uint64:
    return a ^ b ^ c


@inlined
def _carry(a: np.uint64, b: np.uint64, c: np.uint64) -> np.uint64:
    return ((a ^ b) & c) | (~(a ^ b) & a)


@inlined
def _row(start: int, digit: int, w: np.uint64) -> np.uint64:
    return np.uint64(start + digit * LANES) + w


@inlined
def _add_two(block: U64, ones: np.uint64, s: np.uint64, t: np.uint64, w: np.uint64) -> tuple[np.uint64, np.uint64]:
    """What goes on to the second digit, and the first, when two slices are added."""
    a, b = block[s + w], block[t + w]
    return _carry(ones, a, b), _sum(ones, a, b)


@inlined
def _start(taken: U16, k: np.uint64, further: int) -> np.uint64:
    """The word of a block at which a slice begins."""
    return np.uint64(taken[k + np.uint64(further)]) * np.uint64(LANES)


@disjoint
def _add_slices(block: U64, taken: U16, at: int, work: U64) -> None:
    """Add the sixteen slices of numbers taken[at], taken[at + 1], ... to the sums."""
    k = np.uint64(at)
    s0, s1, s2, s3 = _start(taken, k, 0), _start(taken, k, 1), _start(taken, k, 2), _start(taken, k, 3)
    s4, s5, s6, s7 = _start(taken, k, 4), _start(taken, k, 5), _start(taken, k, 6), _start(taken, k, 7)
    s8, s9, s10, s11 = _start(taken, k, 8), _start(taken, k, 9), _start(taken, k, 10), _start(taken, k, 11)
    s12, s13, s14, s15 = _start(taken, k, 12), _start(taken, k, 13), _start(taken, k, 14), _start(taken, k, 15)
    for lane in range(LANES):
        w = np.uint64(lane)
        ones, twos = work[_row(SUMS, 0, w)], work[_row(SUMS, 1, w)]
        fours, eights = work[_row(SUMS, 2, w)], work[_row(SUMS, 3, w)]
        t1, ones = _add_two(block, ones, s0, s1, w)
        t2, ones = _add_two(block, ones, s2, s3, w)
        f1, twos = _carry(twos, t1, t2), _sum(twos, t1, t2)
        t1, ones = _add_two(block, ones, s4, s5, w)
        t2, ones = _add_two(block, ones, s6, s7, w)
        f2, twos = _carry(twos, t1, t2), _sum(twos, t1, t2)
        e1, fours = _carry(fours, f1, f2), _sum(fours, f1, f2)
        t1, ones = _add_two(block, ones, s8, s9, w)
        t2, ones = _add_two(block, ones, s10, s11, w)
        f1, twos = _carry(twos, t1, t2), _sum(twos, t1, t2)
        t1, ones = _add_two(block, ones, s12, s13, w)
        t2, ones = _add_two(block, ones, s14, s15, w)
        f2, twos = _carry(twos, t1, t2), _sum(twos, t1, t2)
        e2, fours = _carry(fours, f1, f2), _sum(fours, f1, f2)
        carried = _carry(eights, e1, e2)
        work[_row(SUMS, 0, w)], work[_row(SUMS, 1, w)] = ones, twos
        work[_row(SUMS, 2, w)], work[_row(SUMS, 3, w)] = fours, _sum(eights, e1, e2)
        digit = work[_row(SUMS, 4, w)]
        work[_row(SUMS, 4, w)], carried = digit ^ carried, digit & carried
        digit = work[_row(SUMS, 5, w)]
        work[_row(SUMS, 5, w)], carried = digit ^ carried, digit & carried
        digit = work[_row(SUMS, 6, w)]
        work[_row(SUMS, 6, w)], carried = digit ^ carried, digit & carried
        digit = work[_row(SUMS, 7, w)]
        work[_row(SUMS, 7, w)], carried = digit ^ carried, digit & carried
        digit = work[_row(SUMS, 8, w)]
        work[_row(SUMS, 8, w)], carried = digit ^ carried, digit & carried
        work[_row(SUMS, 9, w)] ^= carried


@compiled
def _count_slices(block: U64, taken: U16, first: int, number: int, work: U64) -> None:
    """Count for each column how many of `number` slices, named from taken[first] on, hold a one."""
    for at in range(DIGITS * LANES):
        work[at] = ZERO
    for k in range(first, first + number, GROUP):
        _add_slices(block, taken, k, work)


@inlined
def _mask(number: int, digit: int) -> np.uint64:
    """All ones where this binary digit of a number is one."""
    return ZERO - ((np.uint64(number) >> np.uint64(digit)) & ONE)


@compiled
def _compare(own: int, nearest: int, work: U64) -> None:
    """Distances from the sums, of a row with `own` ones; which are below `nearest`, and which their column's best."""
    o0, o1, o2, o3, o4 = _mask(own, 0), _mask(own, 1), _mask(own, 2), _mask(own, 3), _mask(own, 4)
    o5, o6, o7, o8, o9 = _mask(own, 5), _mask(own, 6), _mask(own, 7), _mask(own, 8), _mask(own, 9)
    n0, n1, n2, n3, n4 = _mask(nearest, 0), _mask(nearest, 1), _mask(nearest, 2), _mask(nearest, 3), _mask(nearest, 4)
    n5, n6, n7, n8, n9 = _mask(nearest, 5), _mask(nearest, 6), _mask(nearest, 7), _mask(nearest, 8), _mask(nearest, 9)
    for lane in range(LANES):
        w = np.uint64(lane)
        c, d, less, closer = ZERO, ZERO, ZERO, ZERO
        c, d, less, closer = _digit(work, 0, w, ZERO, o0, n0, c, d, less, closer)
        c, d, less, closer = _digit(work, 1, w, work[_row(SUMS, 0, w)], o1, n1, c, d, less, closer)
        c, d, less, closer = _digit(work, 2, w, work[_row(SUMS, 1, w)], o2, n2, c, d, less, closer)
        c, d, less, closer = _digit(work, 3, w, work[_row(SUMS, 2, w)], o3, n3, c, d, less, closer)
        c, d, less, closer = _digit(work, 4, w, work[_row(SUMS, 3, w)], o4, n4, c, d, less, closer)
        c, d, less, closer = _digit(work, 5, w, work[_row(SUMS, 4, w)], o5, n5, c, d, less, closer)
        c, d, less, closer = _digit(work, 6, w, work[_row(SUMS, 5, w)], o6, n6, c, d, less, closer)
        c, d, less, closer = _digit(work, 7, w, work[_row(SUMS, 6, w)], o7, n7, c, d, less, closer)
        c, d, less, closer = _digit(work, 8, w, work[_row(SUMS, 7, w)], o8, n8, c, d, less, closer)
        c, d, less, closer = _digit(work, 9, w, work[_row(SUMS, 8, w)], o9, n9, c, d, less, closer)
        work[_row(LESS, 0, w)] = less & work[_row(VALID, 0, w)]
        work[_row(CLOSER, 0, w)] = closer & work[_row(VALID, 0, w)]


@inlined
def _digit(
    work: U64, digit: int, w: np.uint64, common: np.uint64, own: np.uint64, nearest: np.uint64,
    carried: np.uint64, borrowed: np.uint64, less: np.uint64, closer: np.uint64,
) -> tuple[np.uint64, np.uint64, np.uint64, np.uint64]:  # fmt: skip
    """One digit of own + total - 2 common; what goes on to the next, and the comparisons up to here."""
    total, best = work[_row(OWN, digit, w)], work[_row(BEST, digit, w)]
    both = total ^ own ^ carried
    far = both ^ common ^ borrowed
    work[_row(FAR, digit, w)] = far
    return (
        (total & own) | ((total ^ own) & carried),
        (~both & (common | borrowed)) | (common & borrowed),
        (~far & best) | (~(far ^ best) & less),
        (~far & nearest) | (~(far ^ nearest) & closer),
    )


@inlined
def _take_digit(work: U64, digit: int, w: np.uint64, less: np.uint64) -> None:
    best = work[_row(BEST, digit, w)]
    work[_row(BEST, digit, w)] = best ^ ((best ^ work[_row(FAR, digit, w)]) & less)


@compiled
def _take(work: U64) -> None:
    """Distances that are below the best of their columns become these."""
    for lane in range(LANES):
        w = np.uint64(lane)
        less = work[_row(LESS, 0, w)]
        _take_digit(work, 0, w, less)
        _take_digit(work, 1, w, less)
        _take_digit(work, 2, w, less)
        _take_digit(work, 3, w, less)
        _take_digit(work, 4, w, less)
        _take_digit(work, 5, w, less)
        _take_digit(work, 6, w, less)
        _take_digit(work, 7, w, less)
        _take_digit(work, 8, w, less)
        _take_digit(work, 9, w, less)


@compiled
def _any(work: U64, start: int) -> np.uint64:
    """A number that is not 0 where there are any columns in a slice."""
    found = ZERO
    for lane in range(LANES):
        w = np.uint64(lane)
        found |= work[np.uint64(start) + w]
    return found


@inlined
def _lowest(word: np.uint64) -> int:
    """Number of the lowest set bit."""
    below = (word & (~word + ONE)) - ONE
    below = below - ((below >> ONE) & np.uint64(0x5555555555555555))
    below = (below & np.uint64(0x3333333333333333)) + ((below >> np.uint64(2)) & np.uint64(0x3333333333333333))
    below = (below + (below >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return int((below * np.uint64(0x0101010101010101)) >> np.uint64(56))


@inlined
def _distance(work: U64, start: int, column: int) -> int:
    """The number whose digits stand in one column."""
    value = 0
    for digit in range(DIGITS):
        word = work[start + digit * LANES + column // 64]
        value |= int((word >> np.uint64(column % 64)) & ONE) << digit
    return value


@compiled
def _nearest(work: U64) -> int:
    """The column of the smallest distance among those that are CLOSER, the first of equal ones."""
    for digit in range(DIGITS - 1, -1, -1):
        low = ZERO
        for lane in range(LANES):
            low |= work[CLOSER + lane] & ~work[FAR + digit * LANES + lane]
        if low != ZERO:
            for lane in range(LANES):
                work[CLOSER + lane] &= ~work[FAR + digit * LANES + lane]
    lane = 0
    while work[CLOSER + lane] == ZERO:
        lane += 1
    return 64 * lane + _lowest(work[CLOSER + lane])


@compiled
def _name_slices(reference: U64, taken: U16, numbers: I64, own: I64) -> None:
    """The slices at which each row has a one, those of row i from taken[i * room] on: `own` and empty ones, `numbers`
    together."""
    n, width = reference.shape
    room = 64 * width + GROUP
    for i in range(n):
        found = i * room
        for word in range(width):
            value = reference[i, word]
            while value != ZERO:
                taken[found] = np.uint16(64 * word + _lowest(value))
                found += 1
                value &= value - ONE
        own[i] = found - i * room
        while (found - i * room) % GROUP:
            taken[found] = np.uint16(64 * width)
            found += 1
        numbers[i] = found - i * room


@compiled
def _begin_block(block: U64, width: int, inside: int, work: U64) -> None:
    """The ones of each column of a block of which `inside` columns exist; no distance is known yet."""
    every = np.empty(64 * width, np.uint16)
    for k in range(len(every)):
        every[k] = np.uint16(k)
    _count_slices(block, every, 0, len(every), work)
    for at in range(DIGITS * LANES):
        work[OWN + at], work[BEST + at] = work[SUMS + at], LARGEST
    for lane in range(LANES):
        left = min(max(inside - 64 * lane, 0), 64)
        work[VALID + lane] = LARGEST if left == 64 else (ONE << np.uint64(left)) - ONE


@compiled
def nearest_by_slices(reference: U64, slices: U64, work: U64, rows: U64, columns: U64) -> None:
    """Nearest neighbours both ways: rows[i] = distance << 32 | j, columns[j] = distance << 32 | i, ties by index.

    `reference` is (N, W) words of at most LONGEST bits, `slices` those of the secondary descriptors by `slice_bits`;
    `work` (MEMORY,) begins with a line of the cache, `rows` (N,) and `columns` (M,) are written.
    """
    n, width = reference.shape
    room = 64 * width + GROUP
    taken, numbers, own = np.empty(n * room, np.uint16), np.empty(n, np.int64), np.empty(n, np.int64)
    _name_slices(reference, taken, numbers, own)
    least, nearest = np.full(n, LONGEST, np.int64), np.zeros(COLUMNS, np.int64)
    rows[:] = LARGEST
    for number in range(slices.shape[0]):
        block, base = slices[number], number * COLUMNS
        inside = min(columns.shape[0] - base, COLUMNS)
        _begin_block(block, width, inside, work)
        for i in range(n):
            _count_slices(block, taken, i * room, numbers[i], work)
            _compare(own[i], least[i], work)
            if _any(work, CLOSER) != ZERO:
                column = _nearest(work)
                least[i] = _distance(work, FAR, column)
                rows[i] = (np.uint64(least[i]) << np.uint64(32)) | np.uint64(base + column)
            if _any(work, LESS) != ZERO:
                _take(work)
                for lane in range(LANES):
                    fresh = work[LESS + lane]
                    while fresh != ZERO:
                        nearest[64 * lane + _lowest(fresh)] = i
                        fresh &= fresh - ONE
        for j in range(inside):
            columns[base + j] = (np.uint64(_distance(work, BEST, j)) << np.uint64(32)) | np.uint64(nearest[j])

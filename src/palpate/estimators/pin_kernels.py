"""The compiled loops that find and follow pins; `pins` uses them, nobody else."""

from __future__ import annotations

import math
from typing import no_type_check

import numba
import numpy as np

ROUNDS = 6  # of looking around where it was found
STILL_PX = 0.005
PARTS = 16  # of a grey level, to which the floor is rounded

i32 = np.int32


@numba.njit(cache=True, nogil=True)
@no_type_check
def settle(pixels, row, margin, xy, reach, floor, sums, weight):
    """Move each place to the centroid of what is brighter than the floor within reach, until it stays.

    Whole numbers, and whole rows of the window in which what is out of reach counts nothing: such a loop
    becomes vectors, one over just what is within reach would not.

    Args:
        pixels, row, margin: an image with a dark margin around, flat, and the length of its rows [px].
        xy: where to start; changed.
        reach: see `Pins`.
        floor: in parts of a grey level, as all sums here are.
        sums: workspace, two numbers for every column of a window.
        weight: to be filled.
    """
    column, column_y = sums[0], sums[1]
    for i in range(len(xy)):
        x, y = xy[i, 0], xy[i, 1]
        for _ in range(ROUNDS):
            if not (0 <= x < row - 2 * margin and 0 <= y < pixels.size // row - 2 * margin):
                break
            left, top = math.floor(x - reach[i]), math.floor(y - reach[i])
            for k in range(column.size):
                column[k] = column_y[k] = 0
            for r in range(top, math.floor(y + reach[i]) + 1):
                half = math.sqrt(max(0.0, reach[i] ** 2 - (r - y) ** 2))
                low, high = i32(math.ceil(x - half) - left), i32(math.floor(x + half) - left)
                below = i32(r - top)
                at = np.uint64((r + margin) * row + left + margin)  # no sign: nothing is counted from the end
                for k in range(column.size):
                    over = max(i32(PARTS) * i32(pixels[at + np.uint64(k)]) - floor, i32(0))
                    over = over if low <= i32(k) <= high else i32(0)
                    column[k] += over
                    column_y[k] += over * below
            total = at_x = at_y = 0
            for k in range(column.size):
                total += column[k]
                at_x += column[k] * k
                at_y += column_y[k]
            weight[i] = total / PARTS
            if total == 0:
                break
            x, y = left + at_x / total, top + at_y / total
            moved = math.hypot(x - xy[i, 0], y - xy[i, 1])
            xy[i, 0], xy[i, 1] = x, y
            if moved < STILL_PX:
                break


@numba.njit(cache=True, nogil=True)
@no_type_check
def _root(parent, i):
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@numba.njit(cache=True, nogil=True)
@no_type_check
def brighter(image, level):
    """Connected patches brighter than a level: of each its pixels, sums of x and y, 1 if off the border.

    A row's runs of bright pixels join those of the row above that they touch, corners included.
    """
    h, w = image.shape
    most = h * (w // 2 + 1)
    parent = np.empty(most, np.int64)
    start, end = np.empty(most, np.int64), np.empty(most, np.int64)  # of runs; end is the first beyond
    sums = np.empty((most, 4))
    n = above = 0
    for r in range(h):
        first, c = n, 0
        while c < w:
            if image[r, c] <= level:
                c += 1
                continue
            start[n] = c
            while c < w and image[r, c] > level:
                c += 1
            end[n], parent[n] = c, n
            size = c - start[n]
            sums[n, 0], sums[n, 1], sums[n, 2] = size, size * (start[n] + c - 1) / 2, size * r
            sums[n, 3] = 0 < r < h - 1 and start[n] > 0 and c < w
            n += 1
        j = above
        for i in range(first, n):
            while j < first and end[j] < start[i]:
                j += 1
            k = j
            while k < first and start[k] <= end[i]:
                a, b = _root(parent, k), _root(parent, i)
                parent[max(a, b)] = min(a, b)
                k += 1
        above = first
    patches = 0
    for i in range(n):
        a = _root(parent, i)
        if a == i:
            patches += 1
        else:
            sums[a, :3] += sums[i, :3]
            sums[a, 3] = min(sums[a, 3], sums[i, 3])
    found = np.empty((patches, 4))
    k = 0
    for i in range(n):
        if parent[i] == i:
            found[k] = sums[i]
            k += 1
    return found

"""Compiled loops of `colour_order`, which alone calls them: orders that a colour allows, and the choice.

Light and table are in standard deviations of the noise, ``[pixels 3]`` and ``[3 rows]``. The misfit of a
pixel to a row of the table is their squared distance; each of its valleys along the rows is an order that
the colour allows.
"""

from typing import no_type_check

import numba
import numpy as np

CHANNELS = 3
SIDE = 32  # cells of the index along each channel
KEPT = 5  # valleys a pixel; at four orders of a white lamp more are never within reach of the best
CAP = 30.0  # a cost beyond which more says nothing: dust, a scratch
BOUND = 6.0  # natural log of the likelihood by which one neighbour may argue at most
REACH = 20  # rows to each side over which a wide valley is integrated
NARROW = 1.0  # of a valley's second difference: below a standard deviation of 1.4 rows
CHANCE = 3.0  # misfit over its freedom, which noise exceeds at one pixel in twenty
SURE = 50.0  # natural log, where there is no second choice
FAST = {"nsz", "arcp", "contract", "afn", "reassoc"}


@numba.njit(cache=True, nogil=True)
@no_type_check
def look_up(image, table, full):
    """Each code's entry of a table ``[256 3]``, and where a channel reaches `full`."""
    h, w, _ = image.shape
    light = np.empty((h, w, CHANNELS), np.float32)
    reached = np.empty((h, w), np.bool_)
    for y in range(h):
        for x in range(w):
            any_ = False
            for c in range(CHANNELS):
                code = image[y, x, c]
                light[y, x, c] = table[code, c]
                any_ = any_ or code >= full
            reached[y, x] = any_
    return light, reached


@numba.njit(cache=True, nogil=True, fastmath=FAST)
@no_type_check
def index_of(table, low, size):
    """Rows of the deepest valleys at the middle of every cell of a grid over the colours, -1 where none."""
    rows = table.shape[1]
    index = np.full((SIDE**3, KEPT), -1, np.int16)
    chi = np.empty(rows, np.float32)
    for cell in range(SIDE**3):
        a = low[0] + (cell // SIDE**2 + np.float32(0.5)) * size[0]
        b = low[1] + (cell // SIDE % SIDE + np.float32(0.5)) * size[1]
        c = low[2] + (cell % SIDE + np.float32(0.5)) * size[2]
        for i in range(rows):
            chi[i] = (a - table[0, i]) ** 2 + (b - table[1, i]) ** 2 + (c - table[2, i]) ** 2
        _deepest(chi, index[cell])
    return index


@numba.njit(cache=True, nogil=True)
@no_type_check
def _deepest(chi, found):
    """Put the rows of the deepest valleys into `found`, and say how many there are."""
    rows, count = chi.size, 0
    for i in range(rows):
        if (i > 0 and chi[i - 1] <= chi[i]) or (i < rows - 1 and chi[i + 1] < chi[i]):
            continue
        if count < found.size:
            found[count] = i
            count += 1
            continue
        worst = 0
        for k in range(1, count):
            if chi[found[k]] > chi[found[worst]]:
                worst = k
        if chi[i] < chi[found[worst]]:
            found[worst] = i
    return count


@numba.njit(cache=True, nogil=True, fastmath=FAST)
@no_type_check
def by_index(light, table, index, low, size):
    """Rows, misfits and number of the orders that each colour allows, downhill from those of its cell."""
    pixels, rows = light.shape[0], table.shape[1]
    row = np.zeros((pixels, KEPT), np.int16)
    chi = np.zeros((pixels, KEPT), np.float32)
    count = np.zeros(pixels, np.uint8)
    for p in range(pixels):
        a, b, c = light[p, 0], light[p, 1], light[p, 2]
        u = min(max(int((a - low[0]) / size[0]), 0), SIDE - 1)
        v = min(max(int((b - low[1]) / size[1]), 0), SIDE - 1)
        w = min(max(int((c - low[2]) / size[2]), 0), SIDE - 1)
        cell, n = (u * SIDE + v) * SIDE + w, 0
        for k in range(KEPT):
            i = index[cell, k]
            if i < 0:
                break
            here = (a - table[0, i]) ** 2 + (b - table[1, i]) ** 2 + (c - table[2, i]) ** 2
            for step in (1, -1):
                moved = False
                while 0 <= i + step < rows:
                    j = i + step
                    next_ = (a - table[0, j]) ** 2 + (b - table[1, j]) ** 2 + (c - table[2, j]) ** 2
                    if next_ >= here:
                        break
                    i, here, moved = j, next_, True
                if moved:
                    break
            known = False
            for m in range(n):
                known = known or row[p, m] == i
            if not known:
                row[p, n], chi[p, n] = i, here
                n += 1
        count[p] = _worthwhile(row[p], chi[p], n)
    return row, chi, count


@numba.njit(cache=True, nogil=True)
@no_type_check
def _worthwhile(row, chi, count):
    """Keep, in front, the orders that four neighbours and a frame before could argue for, and count them."""
    least = np.float32(np.inf)
    for k in range(count):
        least = min(least, chi[k])
    kept = 0
    for k in range(count):
        if chi[k] <= least + 2 * 5 * BOUND:
            row[kept], chi[kept] = row[k], chi[k]
            kept += 1
    return kept


@numba.njit(cache=True, nogil=True, fastmath=FAST)
@no_type_check
def by_scan(light, table, free):
    """The same by setting each colour against every row: the plain way.

    `free`: each pixel's visibility is free, the best from 0.1 to 1, and is returned for each valley.
    """
    pixels, rows = light.shape[0], table.shape[1]
    row = np.zeros((pixels, KEPT), np.int16)
    chi = np.zeros((pixels, KEPT), np.float32)
    count = np.zeros(pixels, np.uint8)
    seen = np.ones((pixels, KEPT), np.float32)
    every, gain = np.empty(rows, np.float32), np.ones(rows, np.float32)
    square = np.maximum(table[0] ** 2 + table[1] ** 2 + table[2] ** 2, np.float32(1e-6))
    for p in range(pixels):
        a, b, c = light[p, 0], light[p, 1], light[p, 2]
        if free:
            for i in range(rows):
                g = (a * table[0, i] + b * table[1, i] + c * table[2, i]) / square[i]
                gain[i] = min(max(g, np.float32(0.1)), np.float32(1.0))
        for i in range(rows):
            g = gain[i]
            every[i] = (a - g * table[0, i]) ** 2 + (b - g * table[1, i]) ** 2 + (c - g * table[2, i]) ** 2
        count[p] = _deepest(every, row[p])
        for k in range(count[p]):
            chi[p, k] = every[row[p, k]]
        count[p] = _worthwhile(row[p], chi[p], count[p])
        for k in range(count[p]):
            seen[p, k] = gain[row[p, k]]
    return row, chi, count, seen


@numba.njit(cache=True, nogil=True)
@no_type_check
def _told(cost, row, count, from_row, from_count, give, told):
    """Put what a neighbour says of each order into `told`: at most `BOUND`, 0 for the one it likes best."""
    least = cost[0]
    for j in range(1, from_count):
        least = min(least, cost[j])
    for k in range(count):
        best = np.float32(BOUND)
        for j in range(from_count):
            apart = np.float32(row[k] - from_row[j])
            best = min(best, cost[j] - least + apart * apart * give)
        told[k] = best


@numba.njit(cache=True, nogil=True)
@no_type_check
def choose(row, chi, count, inside, weight, before, give, follow):
    """Choose one order for each pixel: each row of pixels first, then along columns with what rows say.

    Each pixel's costs become the exact least costs of all choices on the tree of its column and all rows,
    neighbours' orders being apart at (difference / standard deviation)^2 / 2 and never at more than `BOUND`.

    Args: `row`, `chi` ``[h w k]``, `count` and `inside` ``[h w]``; `weight`, what the misfit counts, by
    pixel; `before`, rows of the frame before, -1 without; `give` and `follow`, 1 / (2 variance) of the
    difference between neighbours and between frames, in rows.

    Returns: the index chosen, -1 outside, and the second's lag behind it.
    """
    h, w, kept = row.shape
    cost = np.empty((h, w, kept), np.float32)
    total = np.empty((h, w, kept), np.float32)
    said = np.zeros(kept, np.float32)
    run = np.zeros((w, kept), np.float32)
    for y in range(h):
        for x in range(w):
            old = before[y, x]
            for k in range(count[y, x]):
                own = min(weight[y, x] * chi[y, x, k] / 2, np.float32(CAP))
                if old >= 0:
                    apart = np.float32(row[y, x, k] - old)
                    own += min(np.float32(BOUND), apart * apart * follow)
                cost[y, x, k] = own
                total[y, x, k] = own
        for way in (1, -1):
            x = 0 if way == 1 else w - 1
            for k in range(count[y, x]):
                run[x, k] = cost[y, x, k]
            for _ in range(w - 1):
                last, x = x, x + way
                if count[y, x] == 1:  # it takes what it has, whatever is said
                    run[x, 0] = cost[y, x, 0]
                    continue
                linked = inside[y, last] and inside[y, x]
                if linked:
                    _told(run[last], row[y, x], count[y, x], row[y, last], count[y, last], give, said)
                for k in range(count[y, x]):
                    add = said[k] if linked else np.float32(0.0)
                    run[x, k] = cost[y, x, k] + add
                    total[y, x, k] += add
    cost[:] = total  # with what the row of pixels says
    for way in (1, -1):
        y = 0 if way == 1 else h - 1
        run[:] = cost[y]
        for _ in range(h - 1):
            last, y = y, y + way
            for x in range(w):
                if count[y, x] == 1:
                    run[x, 0] = cost[y, x, 0]
                    continue
                linked = inside[last, x] and inside[y, x]
                if linked:
                    _told(run[x], row[y, x], count[y, x], row[last, x], count[last, x], give, said)
                for k in range(count[y, x]):
                    add = said[k] if linked else np.float32(0.0)
                    run[x, k] = cost[y, x, k] + add
                    total[y, x, k] += add
    at = np.full((h, w), -1, np.int8)
    lead = np.zeros((h, w), np.float32)
    for y in range(h):
        for x in range(w):
            if not inside[y, x] or count[y, x] == 0:
                continue
            best = 0
            for k in range(1, count[y, x]):
                if total[y, x, k] < total[y, x, best]:
                    best = k
            lag = np.float32(SURE)
            for k in range(count[y, x]):
                if k != best:
                    lag = min(lag, total[y, x, k] - total[y, x, best])
            at[y, x], lead[y, x] = best, lag
    _disown(row, at, give, lead)
    return at, lead


@numba.njit(cache=True, nogil=True)
@no_type_check
def _disown(row, at, give, lead):
    """Leave no lead to a pixel that fewer than two of its neighbours go on from: dust, or noise."""
    h, w = at.shape
    far = np.float32(BOUND) / give
    for y in range(h):
        for x in range(w):
            if at[y, x] < 0:
                continue
            near = 0
            for dy, dx in ((-1, 0), (1, 0), (0, -1), (0, 1)):
                v, u = y + dy, x + dx
                if 0 <= v < h and 0 <= u < w and at[v, u] >= 0:
                    apart = np.float32(row[y, x, at[y, x]] - row[v, u, at[v, u]])
                    near += apart * apart < far
            if near < 2:
                lead[y, x] = 0


@numba.njit(cache=True, nogil=True, fastmath=FAST)
@no_type_check
def read_off(light, table, row, seen, at, weight, step, floor, freedom):
    """Order between the rows, its standard deviation, and the misfit over its freedom; NaN where none.

    `seen`, visibilities of the valleys, of no pixel where all are 1.
    """
    pixels, rows = light.shape[0], table.shape[1]
    order = np.full(pixels, np.nan, np.float32)
    sigma = np.full(pixels, np.nan, np.float32)
    misfit = np.full(pixels, np.nan, np.float32)
    chi = np.empty(2 * REACH + 1, np.float32)
    for p in range(pixels):
        if at[p] < 0:
            continue
        i = int(row[p, at[p]])
        g = seen[p, at[p]] if len(seen) > 0 else np.float32(1.0)
        a, b, c, count = light[p, 0], light[p, 1], light[p, 2], weight[p]
        first = max(0, min(i - REACH, rows - chi.size))
        many = min(chi.size, rows)
        for j in range(many):
            r, q, s = table[0, first + j], table[1, first + j], table[2, first + j]
            chi[j] = count * ((a - g * r) ** 2 + (b - g * q) ** 2 + (c - g * s) ** 2)
        k = i - first
        low, before, after = chi[k], chi[max(k - 1, 0)], chi[min(k + 1, many - 1)]
        bend = before - 2 * low + after
        between = 0 < i < rows - 1
        if between:  # the parabola's bottom
            low = max(low - (before - after) ** 2 / (8 * bend + np.float32(1e-20)), np.float32(0.0))
        misfit[p] = low / freedom
        # A misfit that noise explains is noise; beyond, the table is wrong and its order as uncertain.
        wide = misfit[p] if misfit[p] > CHANCE else np.float32(1.0)
        if between and bend > NARROW * wide:  # narrower than rows of the table tell
            order[p] = (i + (before - after) / (2 * bend)) * step
            sigma[p] = np.sqrt(2 * wide / bend * step * step + floor * floor)
            continue
        total, mean, square = np.float32(0.0), np.float32(0.0), np.float32(0.0)
        for j in range(many):
            x = max(np.float32(1.0) - max(chi[j] - chi[k], np.float32(0.0)) / (128 * wide), np.float32(0.0))
            x *= x
            x *= x
            x *= x
            x *= x
            x *= x
            x *= x  # to the 64th: exp(-chi / 2)
            x = x if chi[j] >= chi[k] else np.float32(0.0)  # another, deeper valley
            d = np.float32(j - k)
            total += x
            mean += x * d
            square += x * d * d
        mean /= total
        order[p] = (i + mean) * step
        spread = max(square / total - mean * mean, np.float32(0.0))
        sigma[p] = np.sqrt(spread * step * step + floor * floor)
    return order, sigma, misfit

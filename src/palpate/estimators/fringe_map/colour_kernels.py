"""Compiled loops of `colour_order`: orders that a color allows, and the choice among them.

Light ``[pixels 3]`` and table ``[3 rows]`` are in standard deviations of the noise. Each local minimum of a
pixel's squared distance along the rows is an order that the color allows.
"""

from typing import no_type_check

import numba
import numpy as np

CHANNELS = 3
SIDE = 32  # cells of the index along each channel
KEPT = 5  # valleys a pixel; at four orders of a white lamp more are never within reach of the best
CAP = 30.0  # greatest cost, for dust or a scratch
BOUND = 6.0  # natural log of the likelihood by which one neighbour may argue at most
REACH = 20  # rows to each side over which a wide valley is integrated
CLOSED = 4.0  # misfit at the ends of a valley that is one: two standard deviations
OPEN = 1.0  # standard deviation of an order that may be any within reach
NARROW = 1.0  # of a valley's second difference: below a standard deviation of 1.4 rows
CHANCE = 3.0  # misfit over its freedom, which noise exceeds at one pixel in twenty
SURE = 50.0  # natural log, where there is no second choice
FAST = {"nsz", "arcp", "contract", "afn", "reassoc"}


@numba.njit(cache=True, nogil=True)
@no_type_check
def look_up(image, table, full):
    """Return each code's entry of a table ``[256 3]``, and where a channel reaches `full`."""
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
    """Return rows of the deepest minima at every cell center of a color grid, -1 where none."""
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
    """Return rows, misfits, and number of the orders of each color, descending from its cell."""
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
    """Find the same by comparison with every row; `free`: each pixel's visibility is free, up to 1."""
    pixels, rows = light.shape[0], table.shape[1]
    row = np.zeros((pixels, KEPT), np.int16)
    chi = np.zeros((pixels, KEPT), np.float32)
    count = np.zeros(pixels, np.uint8)
    every = np.empty(rows, np.float32)
    for p in range(pixels):
        a, b, c = light[p, 0], light[p, 1], light[p, 2]
        for i in range(rows):
            every[i] = _misfit(a, b, c, table[0, i], table[1, i], table[2, i], free)
        count[p] = _deepest(every, row[p])
        for k in range(count[p]):
            chi[p, k] = every[row[p, k]]
        count[p] = _worthwhile(row[p], chi[p], count[p])
    return row, chi, count


@numba.njit(cache=True, nogil=True, fastmath=FAST, inline="always")
@no_type_check
def _misfit(a, b, c, r, q, s, free):
    """Squared distance of a colour to one of the table, or to what of it a free visibility leaves."""
    g = np.float32(1.0)
    if free:
        g = (a * r + b * q + c * s) / max(r * r + q * q + s * s, np.float32(1e-6))
        g = min(max(g, np.float32(0.0)), np.float32(1.0))
    return (a - g * r) ** 2 + (b - g * q) ** 2 + (c - g * s) ** 2


@numba.njit(cache=True, nogil=True, inline="always")
@no_type_check
def _pass_on(last, here, row, count, give, run, at, said):
    """Put what the pixel `last` says of each order of `here` into `said`: at most `BOUND`, 0 for the best."""
    least = run[at, 0]
    for j in range(1, count[last]):
        least = min(least, run[at, j])
    for k in range(count[here]):
        best = np.float32(BOUND)
        for j in range(count[last]):
            apart = np.float32(row[here, k] - row[last, j])
            best = min(best, run[at, j] - least + apart * apart * give)
        said[k] = best


@numba.njit(cache=True, nogil=True)
@no_type_check
def _along(cost, row, count, inside, give, width, columns, total):
    """Add to each pixel's total what the rest of its row says, or of its column; both ways, exactly."""
    pixels, kept = cost.shape
    height = pixels // width
    lines, length = (height, width) if columns else (width, height)
    stride = width if columns else 1
    said, run = np.zeros(kept, np.float32), np.zeros((length, kept), np.float32)
    for way in (1, -1):
        for step in range(lines):  # a whole line at once: one pixel's wait for another's hides in it
            line = step if way == 1 else lines - 1 - step
            for at in range(length):
                here = line * width + at if columns else at * width + line
                last = here - way * stride
                if count[here] == 1:  # it takes what it has, whatever is said
                    run[at, 0] = cost[here, 0]
                elif step > 0 and inside[last] and inside[here]:
                    _pass_on(last, here, row, count, give, run, at, said)
                    for k in range(count[here]):
                        run[at, k] = cost[here, k] + said[k]
                        total[here, k] += said[k]
                else:
                    for k in range(count[here]):
                        run[at, k] = cost[here, k]


@numba.njit(cache=True, nogil=True)
@no_type_check
def choose(row, chi, count, inside, weight, before, give, follow, width):
    """Choose one order for each pixel by its color and by all others through rows and columns.

    Costs are exact minima on two trees: the pixel's column with all rows, and its row with all columns.
    Neighbors cost (difference / standard deviation)^2 / 2, at most `BOUND`; one tree alone would let a line
    of pixels outvote its sides.

    Args: `row`, `chi` ``[pixels k]``, `count` and `inside` ``[pixels]``; `weight` of the misfit; `before`,
    rows of the previous frame, -1 without; `give` and `follow`, 1 / (2 variance) of the difference between
    neighbors and between frames, in rows; `width` of the image.

    Returns: the index chosen, -1 outside, and the second's lag behind it.
    """
    pixels, kept = row.shape
    cost = np.zeros((pixels, kept), np.float32)
    for p in range(pixels):
        for k in range(count[p]):
            own = min(weight[p] * chi[p, k] / 2, np.float32(CAP))
            if before[p] >= 0:
                apart = np.float32(row[p, k] - before[p])
                own += min(np.float32(BOUND), apart * apart * follow)
            cost[p, k] = own
    by_rows = cost.copy()
    _along(cost, row, count, inside, give, width, False, by_rows)
    by_columns = cost.copy()
    _along(cost, row, count, inside, give, width, True, by_columns)
    total = by_rows + by_columns
    _along(by_rows, row, count, inside, give, width, True, total)
    _along(by_columns, row, count, inside, give, width, False, total)
    at = np.full(pixels, -1, np.int8)
    lead = np.zeros(pixels, np.float32)
    for p in range(pixels):
        if not inside[p] or count[p] == 0:
            continue
        best = 0
        for k in range(1, count[p]):
            if total[p, k] < total[p, best]:
                best = k
        lag = np.float32(2 * SURE)
        for k in range(count[p]):
            if k != best:
                lag = min(lag, total[p, k] - total[p, best])
        at[p], lead[p] = best, lag / 2  # of two trees
    _disown(row, at, give, width, lead)
    return at, lead


@numba.njit(cache=True, nogil=True)
@no_type_check
def _disown(row, at, give, width, lead):
    """Leave no lead to a pixel that fewer than two of its neighbours go on from: dust, or noise."""
    far = np.float32(BOUND) / give
    for p in range(at.size):
        if at[p] < 0:
            continue
        near, x = 0, p % width
        for q, there in ((p - width, True), (p + width, True), (p - 1, x > 0), (p + 1, x < width - 1)):
            if there and 0 <= q < at.size and at[q] >= 0:
                apart = np.float32(row[p, at[p]] - row[q, at[q]])
                near += apart * apart < far
        if near < 2:
            lead[p] = 0


@numba.njit(cache=True, nogil=True, fastmath=FAST)
@no_type_check
def read_off(light, table, row, at, weight, step, floor, freedom, free):
    """Return the order between rows, its standard deviation (`OPEN` if unbounded), and reduced misfit."""
    pixels, rows = light.shape[0], table.shape[1]
    order = np.full(pixels, np.nan, np.float32)
    sigma = np.full(pixels, np.nan, np.float32)
    misfit = np.full(pixels, np.nan, np.float32)
    chi = np.empty(2 * REACH + 1, np.float32)
    for p in range(pixels):
        if at[p] < 0:
            continue
        i = int(row[p, at[p]])
        a, b, c, count = light[p, 0], light[p, 1], light[p, 2], weight[p]
        first = max(0, min(i - REACH, rows - chi.size))
        many = min(chi.size, rows)
        for j in range(many):
            n = first + j
            chi[j] = count * _misfit(a, b, c, table[0, n], table[1, n], table[2, n], free)
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
        above, below = first + many < rows, first > 0  # there the table goes on
        if (above and chi[many - 1] - chi[k] < CLOSED) or (below and chi[0] - chi[k] < CLOSED):
            order[p], sigma[p] = i * step, OPEN
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

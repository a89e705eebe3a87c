"""The compiled loop of `phase_order`, which alone calls it: unwrapping from one place outwards."""

import heapq
from typing import no_type_check

import numba
import numpy as np

FAR = 1e9


@numba.njit(cache=True, nogil=True)
@no_type_check
def unwrap(order, axis, clear, quality, seed, give, turned):
    """Choose one order for each pixel, from the seed outwards, surest pixels first.

    Args: `order` ``[h w k]``, NaN where there is none, and its doubled `axis` as cosine and sine ``[h w k
    2]``; `clear`, weight of an axis, 0 to 1; `quality`, negative where nothing is; `seed`, row, column, and
    candidate; `give`, standard deviation of the difference between neighbors; `turned`, cost of a
    perpendicular axis.

    Returns: the index chosen, -1 where none was reached, and the second best's lag behind it.
    """
    h, w, count = order.shape
    chosen = np.full((h, w), -1, np.int8)
    lag = np.zeros((h, w), np.float32)
    # What is known of the axis, carried over the folds, where a pixel's own says nothing.
    carried = np.zeros((h, w, 2), np.float32)
    queued = np.zeros((h, w), np.uint8)
    heap = [(np.float32(-1.0), np.int32(seed[0]), np.int32(seed[1]))]
    queued[seed[0], seed[1]] = 1
    started = False
    while len(heap) > 0:
        _, y, x = heapq.heappop(heap)
        best, second, pick = FAR, FAR, -1
        near, cosine, sine, seen = 0.0, 0.0, 0.0, 0.0
        for dy in range(-2, 3):
            for dx in range(-2, 3):
                v, u = y + dy, x + dx
                if 0 <= v < h and 0 <= u < w and chosen[v, u] >= 0:
                    k = chosen[v, u]
                    weight = 1.0 / (dy * dy + dx * dx)
                    near += weight * order[v, u, k]
                    cosine += weight * carried[v, u, 0]
                    sine += weight * carried[v, u, 1]
                    seen += weight
        if started:
            cosine, sine = cosine / seen, sine / seen
        for k in range(count):
            if np.isnan(order[y, x, k]):
                continue
            if started:
                total = (order[y, x, k] - near / seen) ** 2 / (2 * give**2)
                along = cosine * axis[y, x, k, 0] + sine * axis[y, x, k, 1]
                total += clear[y, x] * (1 - along) * turned / 2
            else:
                total = 0.0 if k == seed[2] else FAR / 2
            if total < best:
                best, second, pick = total, best, k
            elif total < second:
                second = total
        if pick < 0:
            continue
        started = True
        chosen[y, x] = pick
        own = clear[y, x] if seen > 0 else np.float32(1.0)
        for part in range(2):
            before = cosine if part == 0 else sine
            carried[y, x, part] = own * axis[y, x, pick, part] + (1 - own) * before
        lag[y, x] = min(second - best, 50.0)
        for dy, dx in ((-1, 0), (1, 0), (0, -1), (0, 1)):
            v, u = y + dy, x + dx
            if 0 <= v < h and 0 <= u < w and queued[v, u] == 0 and quality[v, u] >= 0:
                queued[v, u] = 1
                heapq.heappush(heap, (-quality[v, u], np.int32(v), np.int32(u)))
    return chosen, lag

"""OpenCV's dense flows, to compare with: dense inverse search and Farnebäck's, as OpenCV sets them up."""

from __future__ import annotations

import cv2
import numpy as np

from palpate.estimators.flow.compiled_flow import FlowField
from palpate.estimators.flow.horn_schunck import Grey, brightness, check_pair


def dis(first: Grey, second: Grey) -> FlowField:
    """Dense inverse search, preset MEDIUM [px/frame]; doi:10.1007/978-3-319-46493-0_29.

    Raises:
        ImageError, InputError: images that cannot be read as a pair.
    """
    a, b = _bytes(first, second)
    method = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    return _planes(method.calc(a, b, None))


def farneback(first: Grey, second: Grey) -> FlowField:
    """Farnebäck's polynomial expansion, 3 levels, window 15 px [px/frame]; doi:10.1007/3-540-45103-X_50.

    Raises:
        ImageError, InputError: images that cannot be read as a pair.
    """
    a, b = _bytes(first, second)
    return _planes(
        cv2.calcOpticalFlowFarneback(
            a, b, None, pyr_scale=0.5, levels=3, winsize=15, iterations=3, poly_n=5, poly_sigma=1.2, flags=0
        )
    )


def _bytes(first: Grey, second: Grey) -> tuple[Grey, Grey]:
    check_pair(first, second)
    a, b = (np.round(255 * brightness(image)).astype(np.uint8) for image in (first, second))
    return a, b


def _planes(flow: np.ndarray) -> FlowField:
    return np.ascontiguousarray(np.moveaxis(flow, -1, 0), np.float32)

"""An independent solution of bonded layers, for the tests of stacks."""

import itertools
import math

import numpy as np
import pytest


@pytest.fixture
def solved_at_once():
    """The function below."""
    return _solved_at_once


def _solved_at_once(layers, k, z_asked):
    """Another way: all layers' exponentials as unknowns of one dense system, for a unit pressure wave.

    In a layer, s = k (depth in it), kappa = 3 - 4 nu, and the waves that fall and grow with depth are
    U = (a + b s) e^-s, W = -(a + kappa b + b s) e^-s and U = (c - d s) e^s, W = (c + kappa d - d s) e^s.
    Returns U, W, T, S at a depth, for u_k = i U, u_z = W, s_kz = i T, s_zz = S.
    """

    def states(layer, z):
        nu, mu = layer.poisson_ratio, layer.youngs_modulus_pa / (2 * (1 + layer.poisson_ratio))
        lam, kappa, s = 2 * mu * nu / (1 - 2 * nu), 3 - 4 * nu, k * z
        fall, grow = math.exp(-s), math.exp(s - k * layer.thickness_m)
        U = np.array([fall, s * fall, grow, -s * grow])
        W = np.array([-fall, -(kappa + s) * fall, grow, (kappa - s) * grow])
        dU = k * np.array([-fall, (1 - s) * fall, grow, -(1 + s) * grow])
        dW = k * np.array([fall, (kappa + s - 1) * fall, grow, (kappa - s - 1) * grow])
        return np.array([U, W, mu * (dU + k * W), (lam + 2 * mu) * dW - lam * k * U])

    n = len(layers)
    A, b = np.zeros((4 * n, 4 * n)), np.zeros(4 * n)
    A[0:2, 0:4], b[1] = states(layers[0], 0.0)[2:], -1.0
    for i, (upper, lower) in enumerate(itertools.pairwise(layers)):
        rows = slice(2 + 4 * i, 6 + 4 * i)
        A[rows, 4 * i : 4 * i + 4] = states(upper, upper.thickness_m)
        A[rows, 4 * i + 4 : 4 * i + 8] = -states(lower, 0.0)
    A[-2:, -4:] = states(layers[-1], layers[-1].thickness_m)[:2]
    scale = np.abs(A).max(axis=1)
    unknown = np.linalg.solve(A / scale[:, None], b / scale)
    top = 0.0
    for i, layer in enumerate(layers):
        if z_asked <= top + layer.thickness_m or i == n - 1:
            return states(layer, z_asked - top) @ unknown[4 * i : 4 * i + 4]
        top += layer.thickness_m
    raise AssertionError

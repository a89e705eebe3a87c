"""Frames of specimens whose fringe orders are known in closed form, drawn by the house's optics."""

import numpy as np

from palpate.estimators.fringe_light import white_led
from palpate.estimators.fringe_map import ColourReader
from palpate.mechanics.probe_contact import disc_difference

LED = white_led()


def disc(side=90, steepest=2.5):
    """Share of the centre's order, axis, and where the disc is, without its loads."""
    y, x = np.mgrid[-1 : 1 : side * 1j, -1 : 1 : side * 1j]
    share, axis = disc_difference(x, y)
    inside = np.isfinite(share) & (np.hypot(x, y) < 0.93) & (share < steepest)
    return np.where(inside, share, 0.0), np.nan_to_num(axis), inside


def beam(greatest, height=120, width=80):
    """Orders across a beam in pure bending: even from one edge to the other, 0 at the neutral line."""
    return np.abs(np.linspace(-greatest, greatest, height))[:, None] * np.ones(width)


def colours(order, noise=0.02, seed=0, lamp=LED):
    """Linear light of a circular polariscope's dark field."""
    return lamp.light(order) + noise * np.random.default_rng(seed).standard_normal((*order.shape, 3))


def order_from_colour(image, table, **options):
    """Map of one frame."""
    return ColourReader(table, **options).read(image)

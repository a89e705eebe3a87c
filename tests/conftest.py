"""Shapes are checked in tests and only there; fixtures that every room's tests share."""

from __future__ import annotations

import os
from pathlib import Path

import hypothesis
import jaxtyping
import numpy as np
import pytest

# Before any test imports palpate: what was imported earlier would go unchecked. The numeric tower lets an int
# stand where a float is asked for, as static checkers do.
jaxtyping.install_import_hook(
    "palpate", "beartype.beartype(conf=beartype.BeartypeConf(is_pep484_tower=True))"
)

# No deadline: how long one example takes says more about the machine's other work than about palpate.
hypothesis.settings.register_profile("palpate", deadline=None)
hypothesis.settings.load_profile("palpate")

REPOSITORY = Path(__file__).resolve().parent.parent


@pytest.fixture
def rng() -> np.random.Generator:
    """The same random numbers at every run."""
    return np.random.default_rng(20240607)


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The folder of real recordings, which is not part of the repository."""
    named = os.environ.get("PALPATE_REAL_DATA")
    folder = Path(named) if named else REPOSITORY.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"no real recordings at {folder}; name their folder in PALPATE_REAL_DATA")
    return folder

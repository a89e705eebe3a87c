"""The reference instrument's own uncertainty is in a reading's interval once, and not in the scores."""

from __future__ import annotations

import numpy as np
import pytest

from palpate.calibration.coverage.conformal import fit_intervals
from palpate.core import InputError
from palpate.estimators.model_card import InstrumentCard, TargetCard
from palpate.estimators.reference_uncertainty import reference_half_width, with_reference, without_reference
from palpate.recordings.manifest import read_instruments


def measured_by(half: float) -> TargetCard:
    card = InstrumentCard(
        instrument="scale", certificate="", certified_on="", standard_uncertainty=half, resolution=0.0,
        backlash=0.0, bias_removed=0.0, half_width=half,
    )  # fmt: skip
    return TargetCard.model_construct(measured_by=card)


@pytest.mark.slow
def test_the_truth_is_covered_where_the_instrument_s_scale_is_unknown_and_labels_alone_would_not() -> None:
    """Each of 200 calibrations has its own constant error of the instrument, as large as the model's errors.

    The interval from labels alone is the negative control.
    """
    with_it, without = [], []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        true = rng.uniform(0, 10, (200, 1))
        constant = 0.3 * rng.standard_normal()
        estimate = true + constant + 0.3 * rng.standard_normal((200, 1))  # follows labels, not the truth
        labels = true + constant + 0.02 * rng.standard_normal((200, 1))
        intervals = fit_intervals(estimate, labels, np.arange(200), 0.9)
        low, high = (end[:, 0] for end in intervals.ends(estimate))
        wide = with_reference(measured_by(reference_half_width(0.3, 0.9)), estimate[:, 0], low, high)
        without.append(((low <= true[:, 0]) & (true[:, 0] <= high)).mean())
        with_it.append(((wide[0] <= true[:, 0]) & (true[:, 0] <= wide[1])).mean())
    # The coverage of one calibration varies by 11 %, with its one constant; the mean of 200 by 0.8 %.
    assert np.mean(with_it) == pytest.approx(0.91, abs=0.025)
    assert np.mean(without) < 0.84


def test_the_reference_is_taken_out_again_to_the_last_digits() -> None:
    value, low, high = np.array([1.0, 2.0]), np.array([0.5, 1.9]), np.array([1.1, 4.0])
    target = measured_by(0.4)
    wide = with_reference(target, value, low, high)
    np.testing.assert_allclose(value - wide[0], np.hypot(value - low, 0.4))
    for end, was in zip(without_reference(target, value, *wide), (low, high), strict=True):
        np.testing.assert_allclose(end, was, rtol=1e-12)
    nothing = TargetCard.model_construct(measured_by=None)
    assert with_reference(nothing, 1.0, 0.5, 2.0) == (0.5, 2.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[x_mm]\nresolution = 0.1", r"\[x_mm\]: instrument: Field required"),
        ('[x_mm]\ninstrument = "a"\nresolution = -0.1', "resolution"),
        ('[x_mm]\ninstrument = "a"\nscatter = 0.1', "scatter"),
        ('[x_mm]\ninstrument = "a"\ncertified_on = "last May"', "certified_on"),
        ('[x_mm]\ninstrument = "a"\nstandard_uncertainty = nan', "standard_uncertainty"),
        ("x_mm = 3", r"\[x_mm\]"),
        ("x_mm =", "is no TOML"),
    ],
)
def test_a_file_that_states_no_instrument_is_refused(text, message, tmp_path) -> None:
    (tmp_path / "bad.toml").write_text(text)
    with pytest.raises(InputError, match=message):
        read_instruments(tmp_path / "bad.toml")
    with pytest.raises(InputError, match="check the name"):
        read_instruments(tmp_path / "none.toml")

"""Mixed models of all cues of a comparison: what is corrected, and a cue of which none can be told."""

import numpy as np
import pandas as pd
from numpy.testing import assert_allclose

from palpate.calibration.compliance.specimen_comparison import add_mixed_models, cue_tests, differences_table
from palpate.psychophysics import corrected_by_holm


def test_pairs_of_all_cues_are_corrected_together_and_a_cue_without_a_model_says_why(rng) -> None:
    shared = pd.DataFrame({"day": [f"d{k}" for k in range(4) for _ in range(6)]})
    table = pd.DataFrame({"specimen": ["a", "b", "c"] * 8, "trial": np.arange(24)})
    table["x"] = rng.normal(0, 1, 24)
    table["y"] = 5.0 * (table["specimen"] == "c") + rng.normal(0, 1, 24)
    alone = (shared["day"] == "d0") & (table["specimen"] == "a") | (shared["day"] == "d1") & (
        table["specimen"] == "b"
    )
    table["z"] = rng.normal(0, 1, 24)
    table.loc[~alone, "z"] = np.nan
    record = {"cues": cue_tests(table)}
    add_mixed_models(record, table, shared)
    assert "holds one specimen alone" in record["cues"]["z"]["mixed_model"]["why_not"]
    rows = differences_table(record)
    assert list(rows["cue"]) == ["x"] * 3 + ["y"] * 3
    assert_allclose(rows["p_all_cues"], corrected_by_holm(list(rows["p"])))
    assert (rows["p_all_cues"] >= rows["p"]).all()
    assert record["groups"]["model"] == "specimen + (1 | day)"
    means = table.groupby("specimen")["y"].mean()
    assert_allclose(rows.loc[4, "value"], means["c"] - means["a"])

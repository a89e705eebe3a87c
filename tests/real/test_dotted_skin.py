"""Real images of a dotted skin under dead weights: a stand-in, since no data of our sensors is public."""

import numpy as np
import pandas as pd
import pytest

from palpate.calibration import CalibrationPlan, calibrate
from palpate.estimators import read_card
from palpate.recordings import Run, import_images


@pytest.fixture(scope="module")
def weights(real_data, tmp_path_factory) -> Run:
    """The 150 images as a run; loads that differ by a balance's repeatability are one nominal load."""
    source, folder = real_data / "dotted-skin-weights", tmp_path_factory.mktemp("weights")
    if not source.is_dir():
        pytest.skip(f"no recordings of dead weights at {source}")
    table = pd.read_csv(source / "labels.csv")
    nominal = {
        0.0: "0",
        135.5: "136",
        135.6: "136",
        583.8: "584",
        584.0: "584",
        1011.3: "1011",
        1884.4: "1884",
    }
    table["load"] = "load-" + table["mass_g"].map(nominal)
    table.to_csv(folder / "labels.csv", index=False)
    import_images(source, folder / "run", labels=folder / "labels.csv", image_column="image_file")
    return Run.open(folder / "run")


@pytest.mark.slow
def test_five_nominal_loads_are_held_out_in_turn(weights, tmp_path) -> None:
    plan = CalibrationPlan(("normal_force_N",), split="leave-one-out:load", learn_untouched=True)
    card = read_card(calibrate(weights, plan, tmp_path / "cal"))
    assert card.split.groups == card.split.folds == 5
    assert card.split.clean
    score = card.targets[0].score
    assert score.n == 150
    # A load never seen lies outside what a linear map was fitted on: reported as it comes, no bar.
    assert np.isfinite([score.mae, score.rmse, score.r2]).all()

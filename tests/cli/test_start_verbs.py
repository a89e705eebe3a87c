"""`palpate collect` and `start --terminal`, as typed: what cannot go on ends, and says why."""

from __future__ import annotations

import pytest
from typer.testing import CliRunner

from palpate.cli import app
from palpate.cli.start_verbs import force_of
from palpate.core.errors import InputError


@pytest.mark.parametrize("words", [["collect", "--out"], ["start", "--terminal", "--folder"]])
@pytest.mark.parametrize("typed", ["", "100\nheavy\n"])
def test_weights_that_can_no_more_be_typed_end_it(words: list[str], typed: str, tmp_path) -> None:
    options = ["--camera", "virtual:tactip", "--scale", "typed"]
    done = CliRunner().invoke(app, [*words, str(tmp_path / "kept"), *options], input=typed)
    assert done.exit_code == 2, done.output
    assert "type its mass in g" in done.output
    assert ("'heavy' is no weight" in done.output) == ("heavy" in typed)
    assert "nothing more can be typed" in done.output


@pytest.mark.parametrize(
    "words", ["1,000", "1,000 g", "12,345g", "1_000", "1e3,5", "nan", "inf N", "5 stone"]
)
def test_what_may_mean_two_weights_is_not_guessed(words: str) -> None:
    with pytest.raises(InputError, match="no weight"):
        force_of(words)


@pytest.mark.parametrize(("words", "force_n"), [("0,5 kg", 4.903325), ("2.5N", 2.5), ("1000", 9.80665)])
def test_a_decimal_comma_is_read(words: str, force_n: float) -> None:
    assert force_of(words) == pytest.approx(force_n)

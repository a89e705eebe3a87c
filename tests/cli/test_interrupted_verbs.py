"""Ctrl-C in a verb: what is said then holds for what the verb does."""

from __future__ import annotations

import pytest
from typer.testing import CliRunner

from palpate.cli import app


@pytest.mark.parametrize(
    "words", [["home", "virtual:palm"], ["jog", "virtual:palm", "--axis", "z", "--mm", "1"]]
)
def test_ctrl_c_in_a_verb_that_moves_a_stage_speaks_of_the_stage(
    monkeypatch: pytest.MonkeyPatch, words: list[str]
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("palpate.rig.commissioning.bench.open_bench", interrupted)
    result = CliRunner().invoke(app, ["rig", *words])
    assert result.exit_code == 130
    assert "the probe is not lifted" in result.output
    assert "calibration" not in result.output

"""Commands that installed distributions add: listed without an import, and broken ones refused by a code."""

import json
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.installed_packages import lay_package
from typer.testing import CliRunner

from palpate.cli import app
from palpate.cli.command_tree import ADDED, HEADINGS
from palpate.core.plugins import installed

Install = Callable[..., None]

GROUP = """
import typer
app = typer.Typer()
@app.command()
def greet(name: str = "you"):
    print("hello", name)
@app.command()
def leave():
    raise SystemExit(0)
"""


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Install:
    """Lay a package with a command on the path, as an installer does."""

    def lay(name: str, value: str, code: str = "", package: str = "stranger") -> None:
        (tmp_path / f"{package}.py").write_text(code)
        lay_package(tmp_path, package, "palpate.commands", name, value)
        monkeypatch.syspath_prepend(str(tmp_path))
        monkeypatch.delitem(sys.modules, package, raising=False)

    return lay


@pytest.fixture
def alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Palpate without any distribution that adds to it."""
    monkeypatch.setattr("palpate.core.plugins.installed", lambda group: ())


def refused(*words: str) -> str:
    """Code of the error by which a command ends; its line on stderr is one, without a traceback."""
    result = CliRunner().invoke(app, [*words, "--json"])
    assert result.exit_code == 2, result.output
    assert len(result.stderr.strip().splitlines()) == 1
    return json.loads(result.stdout)["error"]["code"]


def test_an_added_command_runs_and_is_listed_without_being_imported(install: Install) -> None:
    install("wave", "stranger:app", GROUP)
    listed = CliRunner().invoke(app, ["--help"]).output
    assert "\n  wave " in listed
    assert "stranger" not in sys.modules
    result = CliRunner().invoke(app, ["wave", "greet", "--name", "Ada"])
    assert (result.exit_code, result.output) == (0, "hello Ada\n")
    assert CliRunner().invoke(app, ["wave", "leave"]).exit_code == 2


@pytest.mark.parametrize(
    ("value", "code"),
    [
        ("stranger:app", "raise ValueError('two\\nlines')"),
        ("stranger:app", "import sys; sys.exit(0)"),
        ("stranger:app", "import nowhere"),
        ("stranger:app", "other = 1"),
        ("stranger:app", "app = 7"),
        ("stranger:app", "def app(x: int | str): pass"),
        ("stranger", ""),
    ],
)
def test_a_broken_command_is_one_line_with_a_code_and_leaves_the_help_whole(
    install: Install, value: str, code: str
) -> None:
    install("wave", value, code)
    assert refused("wave") in ("plugin", "plugin-import", "not-callable")
    assert "\n  wave " in CliRunner().invoke(app, ["--help"]).output


def test_two_packages_with_one_command_are_refused(install: Install) -> None:
    install("wave", "stranger:app", GROUP)
    install("wave", "another:app", GROUP, package="another")
    assert refused("wave") == "name-taken"


def test_a_command_of_palpate_s_own_is_not_replaced(install: Install) -> None:
    install("mechanics", "stranger:app", GROUP)
    assert "hertz" in CliRunner().invoke(app, ["mechanics", "--help"]).output
    assert "stranger" not in sys.modules


@pytest.mark.usefixtures("alone")
@pytest.mark.parametrize("name", sorted(ADDED))
def test_a_command_whose_distribution_is_not_installed_names_it(name: str) -> None:
    assert refused(name) == "missing-distribution"
    assert ADDED[name][0] in CliRunner().invoke(app, [name, "--help"]).stderr
    assert f"\n  {name} " not in CliRunner().invoke(app, ["--help"]).output


def test_the_distributions_of_the_repository_add_what_is_listed() -> None:
    assert set(ADDED) <= {point.name for point in installed("palpate.commands")}
    assert not set(ADDED) & {name for verbs in HEADINGS.values() for name in verbs}
    listed = CliRunner().invoke(app, ["--help"]).output
    for name, (_, _, sentence) in ADDED.items():
        shown = CliRunner().invoke(app, [name, "--help"]).output
        assert sentence in listed
        assert sentence in shown

"""What the pages name is there: modules, names and keywords in Python, verbs and options as typed."""

import ast
import importlib
import inspect
import re
import shlex
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from tests.cli.walked_commands import commands
from typer.main import get_command

from palpate.cli import app
from palpate.cli.command_kinds import CommandOfKinds
from palpate.cli.sense.preset_verbs import LIST, ListedGroup
from palpate.cli.verb_support import OUTPUT_OPTIONS
from palpate.devices.device_plugins import GROUPS

PROGRAM: Any = get_command(app)
REPOSITORY = Path(__file__).resolve().parents[2]
SOURCE = REPOSITORY / "src" / "palpate"
REPRODUCTIONS = REPOSITORY / "reproductions" / "src" / "palpate_reproductions"
PACKAGES = {SOURCE.name, REPRODUCTIONS.name}
PAGES = {
    path.relative_to(REPOSITORY).as_posix(): path.read_text(encoding="utf-8")
    for path in (
        *sorted(REPOSITORY.glob("*.md")),
        *sorted((REPOSITORY / "docs").rglob("*.md")),
        REPOSITORY / "reproductions" / "README.md",
        *sorted((REPOSITORY / "examples").glob("*.py")),
    )
    if path.name != "CHANGELOG.md"  # it also names what is gone; its new paths have a test of their own
}
OTHER_TOOLS = {"--nproc-per-node", "--standalone", "--nnodes", "--rdzv-backend", "--rdzv-endpoint"}
"""Options that the pages name without their command, of programs other than palpate."""

FENCE = re.compile(r"^```(\w*)\n(.*?)^```", re.DOTALL | re.MULTILINE)
INLINE = re.compile(r"`([^`]+)`")
DOTTED = re.compile(r"(?<![\w./-])palpate(?:_reproductions)?(?:\.[A-Za-z_]\w*)+")
FILE = re.compile(r"(?<![\w./*-])(?:[a-z_]+/)+[a-z_]+\.py\b")
FILE_ALONE = re.compile(r"[a-z_0-9]+\.py")
FOLDER = re.compile(r"(?:[a-z_]+/)+[a-z_]+/?")


def fenced(page: str, *languages: str) -> list[str]:
    """Blocks of a page in one of these languages."""
    return [body for language, body in FENCE.findall(PAGES[page]) if language in languages]


def inline(page: str) -> list[str]:
    """Code within a page's sentences."""
    return [" ".join(code.split()) for code in INLINE.findall(FENCE.sub("", PAGES[page]))]


def python_of(page: str) -> list[str]:
    return [PAGES[page]] if page.endswith(".py") else fenced(page, "python")


def member(dotted: str) -> Any:
    """The module, or what a module holds, under a dotted name."""
    parts = dotted.split(".")
    for count in range(len(parts), 0, -1):
        try:
            owner = importlib.import_module(".".join(parts[:count]))
        except ModuleNotFoundError as e:
            if not (".".join(parts[:count]) + ".").startswith(f"{e.name}."):
                raise
            continue
        for part in parts[count:]:
            owner = getattr(owner, part)
        return owner
    raise AttributeError(dotted)


def missing(dotted: str) -> bool:
    try:
        member(dotted)
    except (AttributeError, ModuleNotFoundError):
        return True
    return False


def bound_by(tree: ast.AST) -> dict[str, str]:
    """Names that a block's imports bind -> what they stand for in palpate."""
    names = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            pairs = [(alias.asname or alias.name.partition(".")[0], alias) for alias in node.names]
            names |= {name: alias.name if alias.asname else name for name, alias in pairs}
        elif isinstance(node, ast.ImportFrom):
            names |= {alias.asname or alias.name: f"{node.module}.{alias.name}" for alias in node.names}
    return {name: dotted for name, dotted in names.items() if dotted.split(".")[0] in PACKAGES}


def imported(tree: ast.AST) -> set[str]:
    """Modules of palpate that a block imports whole."""
    aliases = [alias for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names]
    return {alias.name for alias in aliases if alias.name.split(".")[0] in PACKAGES}


def dotted_name(node: ast.expr, names: dict[str, str]) -> str:
    """What an expression such as ``palm.render`` stands for; empty where it is nothing of palpate."""
    match node:
        case ast.Name(id=name):
            return names.get(name, "")
        case ast.Attribute(value=owner, attr=attribute) if outer := dotted_name(owner, names):
            return f"{outer}.{attribute}"
    return ""


def faults_of_python(code: str) -> Iterator[str]:
    """Imports, attributes and keywords in a block of Python that palpate does not have."""
    tree = ast.parse(code)
    names = bound_by(tree)
    yield from sorted(dotted for dotted in {*names.values(), *imported(tree)} if missing(dotted))
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and (dotted := dotted_name(node, names)) and missing(dotted):
            yield dotted
        if isinstance(node, ast.Call) and (dotted := dotted_name(node.func, names)) and not missing(dotted):
            named = [one.arg for one in node.keywords if one.arg]
            yield from (f"{dotted}({name}=…)" for name in named if not takes(member(dotted), name))


def takes(function: Any, keyword: str) -> bool:
    """Whether a function or class takes an argument of this name."""
    parameters = inspect.signature(function).parameters
    return keyword in parameters or any(one.kind is one.VAR_KEYWORD for one in parameters.values())


@pytest.mark.parametrize("page", [page for page in PAGES if python_of(page)])
def test_the_python_of_a_page_names_what_palpate_has(page: str) -> None:
    assert not [fault for code in python_of(page) for fault in faults_of_python(code)]


@pytest.mark.parametrize(
    "code",
    [
        "import palpate.nowhere",
        "from palpate import Plans",
        "from palpate.rig.plans import Stepped as S",
        "import palpate\npalpate.sensors_of()",
        "from palpate.sensors import palm\npalm.rendered",
        "from palpate import CalibrationPlan\nCalibrationPlan((), fold=1)",
    ],
)
def test_a_name_that_is_gone_is_noticed(code: str) -> None:
    assert list(faults_of_python(code))


REGISTERED = {*GROUPS.values(), "palpate.commands", "palpate.sensors", "palpate.models", "palpate.splits"}
"""Groups of entry points: names with a dot that need not be modules."""


@pytest.mark.parametrize("page", PAGES)
def test_dotted_names_on_a_page_are_those_of_modules_and_their_members(page: str) -> None:
    named = set(DOTTED.findall(PAGES[page])) - REGISTERED
    assert not sorted(dotted for dotted in named if missing(dotted))


@pytest.mark.parametrize("page", PAGES)
def test_files_and_folders_that_a_page_names_are_there(page: str) -> None:
    rooms = {path.name for path in SOURCE.iterdir() if path.is_dir()}
    folders = {code for code in inline(page) if FOLDER.fullmatch(code) and code.split("/")[0] in rooms}
    named = folders | {path for code in inline(page) for path in FILE.findall(code)}
    roots = (REPOSITORY, REPOSITORY / "src", SOURCE, REPRODUCTIONS)
    assert not sorted(
        one
        for one in named
        if not any((root / one).exists() or (root / f"{one}.py").exists() for root in roots)
    )


@pytest.mark.parametrize("page", PAGES)
def test_files_that_a_page_names_without_a_folder_are_there(page: str) -> None:
    folders = (SOURCE, REPRODUCTIONS, REPOSITORY / "tools", REPOSITORY / "tests", REPOSITORY / "examples")
    known = {path.name for folder in folders for path in folder.rglob("*.py")}
    assert not sorted({code for code in inline(page) if FILE_ALONE.fullmatch(code)} - known)


def lines_typed(page: str) -> Iterator[str]:
    """Command lines that begin with palpate: in blocks, continued lines joined, and within sentences."""
    blocks = "\n".join(fenced(page, "", "sh", "bash", "console"))
    joined = re.sub(r"\\\n\s*", " ", blocks)
    for line in [*joined.splitlines(), *inline(page)]:
        words = line.split(" -m palpate.cli ")[-1] if " -m palpate.cli " in line else line
        if words != line or re.match(r"palpate\s+[a-z-]", line):
            yield words.removeprefix("palpate").strip()


def fault_of_line(line: str) -> str:
    """The word of a command line, without its first, that no verb takes; empty where all are known."""
    command = PROGRAM
    for word in shlex.split(line, comments=True):
        members = getattr(command, "commands", None)
        if isinstance(command, CommandOfKinds) and command.usage == "KIND" and members is None:
            members = {kind: command.of(kind) for kind in command.places}
        if word in ("|", ">", "&&", ";", "…", "..."):
            break
        if word.startswith("--"):
            if word.partition("=")[0] not in known_options(command) | {"--help"}:
                return word
        elif members is not None and word in members:
            command = members[word]
        elif isinstance(command, ListedGroup):
            command = command.commands[LIST]
        elif members is not None:
            return word
    return ""


def known_options(command: Any) -> set[str]:
    kinds = [one for _, one in getattr(command, "kinds", [("", command)])]
    chosen = {command.usage.split()[0]} if isinstance(command, CommandOfKinds) else set()
    options = {word for kind in kinds for one in kind.params for word in (*one.opts, *one.secondary_opts)}
    return {option for option in options | chosen if option[:1] == "-"} | set(OUTPUT_OPTIONS)


@pytest.mark.parametrize("page", [page for page in PAGES if list(lines_typed(page))])
def test_command_lines_on_a_page_are_those_of_the_program(page: str) -> None:
    assert not {line: fault for line in lines_typed(page) if (fault := fault_of_line(line))}


@pytest.mark.parametrize("line", ["recrod --out run", "record --outt run", "rig chek bench.toml"])
def test_a_verb_or_an_option_that_is_not_there_is_noticed(line: str) -> None:
    assert fault_of_line(line)


@cache
def all_options(command: Any) -> set[str]:
    """Options of a verb, or of all verbs of a group."""
    members = getattr(command, "commands", {})
    return known_options(command).union(*(all_options(members[name]) for name in members))


@pytest.mark.parametrize("page", PAGES)
def test_options_named_alone_are_those_of_a_verb(page: str) -> None:
    named = {code.split()[0].partition("=")[0] for code in inline(page) if code.startswith("--")}
    assert not sorted(named - all_options(PROGRAM) - OTHER_TOOLS - {"--help"})


def test_new_paths_in_the_changelog_are_there() -> None:
    changelog = (REPOSITORY / "CHANGELOG.md").read_text(encoding="utf-8")
    rows = [line.strip("|").split("|") for line in changelog.splitlines() if line.startswith("| `palpate.")]
    new = {dotted for row in rows for dotted in DOTTED.findall(row[1])}
    old = {dotted for row in rows for dotted in DOTTED.findall(row[0])}
    assert new, "the table from old to new import paths is there"
    assert not sorted(dotted for dotted in new if missing(dotted))
    assert not sorted(dotted for dotted in old if not missing(dotted))


def test_the_examples_in_the_help_of_each_command_are_of_the_program() -> None:
    helps = [" ".join((one.help or "").split()) for _, one in commands(PROGRAM)]
    examples = [line for text in helps for line in re.findall(r"Example: palpate (.+?)(?= Example:|$)", text)]
    assert len(examples) > 60
    assert not {line: fault for line in examples if (fault := fault_of_line(line))}

"""The page of exit codes is complete: it has each code in the source, and each command's own 1."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

from cairn.runtime.process_exit import ExitReport
from tests.commands import cairn

SOURCES = ("cairn", "components", "supervisors", "lab/cairn_lab")
ENDINGS = {"typer.Exit", "sys.exit", "SystemExit", "os._exit", "end_process"}
PAGE = "docs/reference/exit-codes.md"
# Commands that return 1 for a result that is not good, by the module that has them.
OWN_CODE_1 = {
    "cairn/cli/check.py": "cairn check --json",
    "cairn/cli/doctor/command.py": "cairn doctor",
    "cairn/cli/systemd_service.py": "cairn service status",
    "cairn/rerun/cli.py": "cairn rerun",
    "lab/cairn_lab/evaluation/cli.py": "cairn evaluate",
    "lab/cairn_lab/experiments/cli.py": "cairn experiment",
}


@pytest.fixture
def page(root: Path) -> str:
    return (root / PAGE).read_text(encoding="utf-8")


@cache
def endings(root: Path) -> list[tuple[str, str, int]]:
    """Return module, function and code of each call that ends a process with a literal code."""
    found = []
    for folder in SOURCES:
        for file in sorted((root / folder).rglob("*.py")):
            text = file.read_text(encoding="utf-8")
            by_link = not file.resolve().is_relative_to((root / folder).resolve())
            if by_link or not any(f"{ending}(" in text for ending in ENDINGS):
                continue
            for node in ast.walk(ast.parse(text)):
                if not isinstance(node, ast.Call) or ast.unparse(node.func) not in ENDINGS:
                    continue
                code = node.args[0] if node.args else ast.Constant(0)
                if isinstance(code, ast.Constant) and isinstance(code.value, int):
                    name = file.relative_to(root).as_posix()
                    found.append((name, ast.unparse(node.func), code.value))
    return found


def described(page: str, heading: str) -> set[str]:
    """Return what the first column of the table below a heading has."""
    section = re.split(r"^#+ ", page.partition(f"# {heading}\n")[2], flags=re.MULTILINE)[0]
    return set(re.findall(r"^\| `?([^|`]+?)`? \|", section, re.MULTILINE)) - {"code", "command"}


def test_every_code_in_the_source_is_described(root: Path, page: str) -> None:
    found = endings(root)
    codes = described(page, "Commands")

    assert len(found) > 10
    assert [one for one in found if str(one[2]) not in codes] == []


def test_every_command_with_a_code_1_of_its_own_is_described(root: Path, page: str) -> None:
    modules = {name for name, function, code in endings(root) if function == "typer.Exit" and code}

    assert modules == set(OWN_CODE_1)
    assert described(page, "Code 1 without an error") == set(OWN_CODE_1.values())


def test_codes_of_components_are_described(page: str) -> None:
    reports = (
        ExitReport(normal=True, reason=""),
        ExitReport(normal=True, reason="", success=False),
        ExitReport(normal=False, reason=""),
    )

    codes = {str(report.exit_code) for report in reports}
    assert codes == {"0", "100", "1"}
    assert described(page, "Processes of components") == codes | {"other", "signal"}


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        ("--version", 0),
        ("check no_such_file.yaml", 1),
        ("check no_such_file.yaml --json", 1),
        ("no_such_command", 2),
        ("ps --no-such-option", 2),
        ("up", 2),
    ],
)
def test_commands_end_with_the_described_code(arguments: str, code: int) -> None:
    assert cairn(*arguments.split()).code == code

"""What the README and the pages of docs/ show is true: code, commands, links."""

import json
import re
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.commands import cairn

ROOT = Path(__file__).parents[2]
# Pages of the site have their links checked by `make docs`.
OUTSIDE_THE_SITE = ("README.md", "CONTRIBUTING.md", "SECURITY.md", "CHANGELOG.md")
# The deployments of these pages are the reader's: their own tests write them.
READERS_FILES = ("docs/reference/deployment.md", "docs/tutorial.md")
PAGES = tuple(
    page
    for page in ("README.md", *(str(p.relative_to(ROOT)) for p in (ROOT / "docs").rglob("*.md")))
    if page not in READERS_FILES
)
# Those that need no running robot, in any page; the others are tried by the tests of the CLI.
LONG = re.compile("cairn (map build|map import|camera calibrate) ")  # seconds of computation
OFFLINE = ("cairn check deploy/", "cairn schema ", "cairn plugins", "cairn map ", "cairn camera ")
ONLINE = ("cairn map save ",)  # exceptions: those need one
SCANNER = """\


class Scanner(Component):
    scan: Out[LaserScan] = Out(qos=SENSOR)
"""


def offline_commands() -> list[tuple[str, str]]:
    root = Path(__file__).parents[2]
    found = []
    for page in PAGES:
        text = (root / page).read_text(encoding="utf-8")
        for block in re.findall(r"^```sh\n(.*?)^```", text, re.DOTALL | re.MULTILINE):
            lines = [line for line in block.splitlines() if line.startswith(OFFLINE)]
            lines = [line for line in lines if not line.startswith(ONLINE)]
            found += [(page, line) for line in lines if "turtle" not in line and line[-1] != "\\"]
    return found


@pytest.mark.slow
@pytest.mark.parametrize(
    "command",
    [
        pytest.param(command, marks=[pytest.mark.accuracy] if LONG.match(command) else [])
        for command in sorted({command for _, command in offline_commands()})
    ],
)
def test_commands_that_need_no_robot_work_as_shown(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    words = shlex.split(command, comments=True)[1:]
    # In a folder of its own, so that what is written is not written into the project.
    for name in ("deploy", "tests"):
        (tmp_path / name).symlink_to(root / name)
    monkeypatch.chdir(tmp_path)

    if "MRCLAM_Dataset9" not in words:
        answer = cairn(*words)
        assert answer.code == 0, answer.err


def test_component_of_the_readme_passes_the_check_of_its_deployment(
    shell: Callable[[Path, Path], Any], page_blocks: Callable[[str], Any], tmp_path: Path
) -> None:
    (component,) = [block for block in page_blocks("README.md") if block.language == "python"]
    (deployment,) = [block for block in page_blocks("README.md") if block.language == "yaml"]
    (tmp_path / "readme_robot.py").write_text(component.text + SCANNER, encoding="utf-8")
    (tmp_path / "rover.yaml").write_text(deployment.text, encoding="utf-8")

    checked = json.loads(shell(tmp_path, tmp_path).cairn("check", "rover.yaml", "--json"))

    names = ["supervisor", "scanner", "wanderer"]
    assert checked == {"valid": True, "components": names, "warnings": []}


@pytest.mark.parametrize("page", OUTSIDE_THE_SITE)
def test_links_have_existing_targets(root: Path, page: str) -> None:
    text = (root / page).read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", text):
        if not target.startswith("docs/images/"):  # made by the demo
            assert (root / page).parent.joinpath(target).exists(), f"{page} links to {target}"


@pytest.mark.parametrize("page", OUTSIDE_THE_SITE)
def test_links_to_headings_have_existing_targets(root: Path, page: str) -> None:
    text = (root / page).read_text(encoding="utf-8")
    for target, heading in re.findall(r"\]\(([^)#:]*)#([^)]+)\)", text):
        other = (root / page).parent / target if target else root / page
        assert heading in anchors(other.read_text(encoding="utf-8")), f"{page}: #{heading}"


def anchors(text: str) -> set[str]:
    """The names that GitHub gives to the headings of a page, and those given in it."""
    headings = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    named = {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}
    return named | set(re.findall(r'<a id="([^"]+)">', text))


def test_every_field_of_the_report_is_described(root: Path) -> None:
    from cairn.components.run_outputs.run_record import RunRecord

    record = RunRecord()
    record.object(1)
    summary = record.summary(1.0)
    page = (root / "docs" / "how-to" / "replay.md").read_text(encoding="utf-8")
    described = set(re.findall(r"`(?:objects\[\]\.|\.)?(\w+)`", page))

    assert summary.keys() - {"objects"} <= described
    assert summary["objects"][0].keys() <= described

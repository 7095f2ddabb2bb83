"""The tutorial's package: how many tests it has, and the change of its component in step 4."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.commands import cairn


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    assert cairn("init", "my_robot").code == 0
    return tmp_path / "my_robot"


@pytest.fixture
def page(root: Path) -> str:
    return (root / "docs" / "tutorial.md").read_text(encoding="utf-8")


def run_pytest(project: Path, *arguments: str) -> str:
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *arguments]
    run = subprocess.run(command, cwd=project, capture_output=True, text=True, timeout=120)
    return run.stdout


@pytest.mark.accuracy
def test_package_has_as_many_tests_as_stated(page: str, project: Path) -> None:
    [stated] = re.findall(r"# (\d+) tests pass", page)

    assert f"\n{stated} tests collected" in run_pytest(project, "--collect-only")


@pytest.mark.accuracy
def test_change_of_the_component_fails_one_test_until_its_expectation_follows(
    page: str, project: Path
) -> None:
    method, expectation = re.findall(
        r"^```python\n(.*?)^```", page.partition("## 4.")[2], re.DOTALL | re.MULTILINE
    )
    cruise, test = project / "my_robot" / "cruise.py", project / "tests" / "test_cruise.py"

    before = cruise.read_text()
    after = re.sub(
        r"    @every\(hz=10\)\n.*?\n\n", lambda _: method + "\n", before, flags=re.DOTALL
    )
    assert after != before
    cruise.write_text(after)
    assert "1 failed, 2 passed" in run_pytest(project, "--noconftest", "tests/test_cruise.py")

    before = test.read_text()
    after = before.replace("    assert see(cruise, 1.1) == 0.4\n", expectation)
    assert after != before
    test.write_text(after.replace("import math\n", "import math\nimport pytest\n"))
    assert "3 passed" in run_pytest(project, "--noconftest", "tests/test_cruise.py")

"""Step 4 of the tutorial: its change of the skeleton's component, and of the test of it."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.commands import cairn


def run_test_of_cruise(project: Path) -> str:
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--noconftest"]
    run = subprocess.run(
        [*command, "tests/test_cruise.py"], cwd=project, capture_output=True, text=True, timeout=120
    )
    return run.stdout


def test_change_of_the_component_fails_one_test_until_its_expectation_follows(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = (root / "docs" / "tutorial.md").read_text(encoding="utf-8")
    method, expectation = re.findall(
        r"^```python\n(.*?)^```", page.partition("## 4.")[2], re.DOTALL | re.MULTILINE
    )
    monkeypatch.chdir(tmp_path)
    assert cairn("init", "my_robot").code == 0
    project = tmp_path / "my_robot"
    cruise, test = project / "my_robot" / "cruise.py", project / "tests" / "test_cruise.py"

    before = cruise.read_text()
    after = re.sub(
        r"    @every\(hz=10\)\n.*?\n\n", lambda _: method + "\n", before, flags=re.DOTALL
    )
    assert after != before
    cruise.write_text(after)
    assert "1 failed, 2 passed" in run_test_of_cruise(project)

    before = test.read_text()
    after = before.replace("    assert see(cruise, 1.1) == 0.4\n", expectation)
    assert after != before
    test.write_text(after.replace("import math\n", "import math\nimport pytest\n"))
    assert "3 passed" in run_test_of_cruise(project)

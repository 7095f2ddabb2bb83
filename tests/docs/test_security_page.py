"""The security page: each row of its threat model names a test that exists."""

import re
from pathlib import Path

PAGE = "docs/concepts/security.md"
_CELLS = 4  # attacker, can, cannot, shown by


def test_every_attacker_has_a_test_that_exists(root: Path) -> None:
    rows = [
        cells
        for line in (root / PAGE).read_text(encoding="utf-8").splitlines()
        if len(cells := line.strip("|").split("|")) == _CELLS and line.startswith("| ")
    ]
    attackers = {row[0].strip(): re.findall(r"`([^`]+)`", row[-1]) for row in rows[1:]}
    attackers.pop("attacker", None)  # the heading of the second table

    assert len(attackers) > 15
    assert {name for name, tests in attackers.items() if not tests} == set()
    named = {test for tests in attackers.values() for test in tests}
    paths = {test: test if "/" in test else f"tests/attack/{test}" for test in named}
    assert {test for test, path in paths.items() if not (root / path).exists()} == set()

"""The lab uses public names of `cairn`, and `cairn` does not use the lab."""

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]


def imports(*folders: str) -> Iterator[tuple[str, str, str]]:
    """Yield file, module and name of each name that the modules of these folders import."""
    for folder in folders:
        for file in sorted((ROOT / folder).rglob("*.py")):
            where = str(file.relative_to(ROOT))
            for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
                if isinstance(node, ast.ImportFrom):
                    yield from ((where, node.module or "", alias.name) for alias in node.names)
                elif isinstance(node, ast.Import):
                    yield from ((where, alias.name, "") for alias in node.names)


def test_lab_imports_no_private_name_of_cairn() -> None:
    private = [
        one
        for one in imports("lab/cairn_lab")
        if one[1].split(".")[0] == "cairn"
        and any(part.startswith("_") for part in (*one[1].split("."), one[2]))
    ]

    assert private == []


def test_cairn_does_not_import_the_lab() -> None:
    found = imports("cairn", "components", "schemas", "supervisors")

    assert [one for one in found if one[1].split(".")[0] == "cairn_lab"] == []

"""The public names of the package: complete, typed, documented, and fast to import."""

import ast
import subprocess
import sys
from inspect import getdoc
from itertools import pairwise
from pathlib import Path

import pytest

import cairn

TREE = ast.parse(Path(cairn.__file__).read_text())


def _type_checking_imports() -> dict[str, set[str]]:
    block = next(node for node in TREE.body if isinstance(node, ast.If))
    imports = [node for node in block.body if isinstance(node, ast.ImportFrom)]
    return {str(node.module): {alias.name for alias in node.names} for node in imports}


def _documented_constants(module: str) -> set[str]:
    """Return the names assigned in a module that a string literal follows."""
    file = sys.modules[module].__file__
    assert file is not None
    body = ast.parse(Path(file).read_text()).body
    return {
        target.id
        for statement, after in pairwise(body)
        if isinstance(statement, ast.Assign)
        and isinstance(after, ast.Expr)
        and isinstance(after.value, ast.Constant)
        and isinstance(after.value.value, str)
        for target in statement.targets
        if isinstance(target, ast.Name)
    }


def test_public_names_the_lazy_table_and_the_typed_imports_agree() -> None:
    table = {module: set(names) for module, names in cairn._MODULES.items()}

    assert table == _type_checking_imports()
    assert sorted(name for names in table.values() for name in names) == sorted(cairn.__all__)
    assert dir(cairn) == sorted(cairn.__all__)


@pytest.mark.parametrize("name", cairn.__all__)
def test_public_name_is_documented(name: str) -> None:
    value = getattr(cairn, name)
    (module,) = (module for module, names in cairn._MODULES.items() if name in names)
    if getattr(value, "__module__", None) == module:
        assert getdoc(value)
    else:
        assert name in _documented_constants(module)


def test_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'Componnt'"):
        cairn.Componnt  # type: ignore[attr-defined] # noqa: B018 - the access is the test


def test_names_for_components_import_neither_zenoh_nor_other_heavy_libraries() -> None:
    names = [name for name in cairn.__all__ if name != "connect"]  # which opens a session
    script = (
        "import sys; before = set(sys.modules); import cairn; "
        "assert 'numpy' not in sys.modules, 'import cairn alone loads numpy'; "
        f"from cairn import {', '.join(names)}; "
        "print(*sorted({name.partition('.')[0] for name in set(sys.modules) - before}))"
    )
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    heavy = {"zenoh", "cv2", "psutil", "numba", "scipy", "rosbags", "typer", "rich", "yaml"}

    assert {"numpy", "pydantic"} <= set(run.stdout.split())
    assert heavy & set(run.stdout.split()) == set()

"""Compiled kernels: an edit of any compiled part takes effect in the next process."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cairn.planar.compiled import compiled, fingerprint

pytestmark = pytest.mark.slow


LIMITS = "FACTOR = 2.0\n"
CALLEE = """
from cairn.planar.compiled import compiled
from edited_package.limits import FACTOR

@compiled()
def scaled(value: float) -> float:
    return FACTOR * value
"""
CALLER = """
from cairn.planar.compiled import compiled
from edited_package.callee import scaled

@compiled("float64(float64)")
def caller(value: float) -> float:
    return scaled(value) + 1.0
"""
RUN = """
import json
from edited_package.caller import caller
print(json.dumps([caller(10.0), sum(caller.stats.cache_hits.values())]))
"""


class Package:
    """A package of three modules, of which the last calls a kernel of the second."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder / "edited_package"
        self.cache = self.folder / "__pycache__"
        self._environment = {**os.environ, "PYTHONPATH": str(folder)}
        self._environment.pop("NUMBA_CACHE_DIR", None)

    def create(self) -> None:
        """Write the modules."""
        self.folder.mkdir()
        for name, text in (("limits", LIMITS), ("callee", CALLEE), ("caller", CALLER)):
            self.write(name, text)

    def write(self, module: str, text: str) -> None:
        (self.folder / f"{module}.py").write_text(text)

    def run(self, prepare: str = "", **environment: str) -> tuple[float, bool]:
        """The result of the caller for 10 in a new process, and whether it came from the cache."""
        done = subprocess.run(
            [sys.executable, "-B", "-c", prepare + RUN],
            env={**self._environment, **environment},
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        value, hits = json.loads(done.stdout)
        return value, hits > 0


@pytest.fixture(scope="module")
def first_run(tmp_path_factory: pytest.TempPathFactory) -> Package:
    """A package that has run once, to be copied only: each run takes a second."""
    package = Package(tmp_path_factory.mktemp("first"))
    package.create()
    assert package.run() == (21.0, False)
    return package


@pytest.fixture
def package(first_run: Package, tmp_path: Path) -> Package:
    shutil.copytree(first_run.folder, tmp_path / first_run.folder.name)
    return Package(tmp_path)


@pytest.mark.accuracy
def test_edit_of_a_callee_in_another_file_takes_effect_in_the_next_process(
    package: Package,
) -> None:
    removed = [
        package.cache / "caller.gone.cpython-311.1.nbc",
        package.cache / "caller.b-1.py311.nbi",
    ]
    for file in removed:
        file.touch()

    package.write("callee", CALLEE.replace("FACTOR * value", "FACTOR * value + 100.0"))
    assert package.run() == (121.0, False)

    assert not any(file.exists() for file in removed), "code of removed kernels"
    assert list(package.cache.glob("caller.caller.*.nbi"))
    package.write("limits", "FACTOR = 3.0\n")
    assert package.run() == (131.0, False)


def test_unchanged_kernel_comes_from_the_cache_whatever_its_comments(package: Package) -> None:
    files = sorted(path.name for path in package.cache.glob("*.nb?"))

    package.write("callee", "# A comment.\n" + CALLEE)
    package.write("caller", "# A comment.\n" + CALLER)

    assert package.run() == (21.0, True)
    assert sorted(path.name for path in package.cache.glob("*.nb?")) == files


@pytest.mark.accuracy
def test_cache_that_is_filled_before_the_compilation_is_used(tmp_path: Path) -> None:
    package = Package(tmp_path)
    package.create()
    prepare = (
        "from cairn.cli import kernel_helper\n"
        "from cairn.system.kernel_compilation import before_compilation\n"
        "kernel_helper.PACKAGES = ('edited_package',)\n"
        "before_compilation(kernel_helper.compile_in_helper)\n"
    )

    assert package.run(prepare) == (21.0, True)


@pytest.mark.accuracy
def test_deferred_kernel_is_compiled_by_its_first_call(tmp_path: Path) -> None:
    package = Package(tmp_path)
    package.create()
    prepare = (
        "from cairn.system.kernel_compilation import deferred_compilation\n"
        "with deferred_compilation():\n"
        "    from edited_package.caller import caller\n"
        "assert not caller.signatures\n"
    )

    assert package.run(prepare) == (21.0, False)
    assert package.run(prepare) == (21.0, True)


@pytest.mark.accuracy
def test_deferred_kernels_are_compiled_by_other_processes(tmp_path: Path) -> None:
    package = Package(tmp_path)
    package.create()
    prepare = (
        "from cairn.system.kernel_compilation import compile_deferred, deferred_compilation\n"
        "with deferred_compilation():\n"
        "    from edited_package.caller import caller\n"
        "assert compile_deferred() and not caller.signatures\n"
    )

    assert package.run(prepare) == (21.0, True)


@pytest.mark.accuracy
def test_cache_of_a_read_only_package_is_in_the_folder_that_the_environment_names(
    tmp_path: Path,
) -> None:
    package = Package(tmp_path)
    package.create()
    elsewhere = tmp_path / "elsewhere"

    assert package.run(NUMBA_CACHE_DIR=str(elsewhere)) == (21.0, False)
    assert package.run(NUMBA_CACHE_DIR=str(elsewhere)) == (21.0, True)

    assert not list(package.folder.rglob("*.nb?"))
    assert list(elsewhere.rglob("caller.caller.*.nbi"))


def _reads(value: Any) -> Callable[[], Any]:
    """A function that reads `value` as a global constant."""
    names = {"CONSTANT": value}
    exec("def kernel():\n    return CONSTANT\n", names)
    kernel: Callable[[], Any] = names["kernel"]
    return kernel


@pytest.mark.parametrize(
    ("value", "other"),
    [
        (1, 2),
        (1.0, 1),
        ((1, 2), (2, 1)),
        (np.array([1, 2]), np.array([1, 3])),
        (np.array([1, 2]), np.array([1.0, 2.0])),
        (compiled()(lambda: 1), compiled()(lambda: 2)),
    ],
)
def test_fingerprint_depends_on_each_constant_and_callee(value: object, other: object) -> None:
    assert fingerprint(_reads(value)) == fingerprint(_reads(value))
    assert fingerprint(_reads(value)) != fingerprint(_reads(other))
    assert fingerprint(_reads(value), True) != fingerprint(_reads(value), False)

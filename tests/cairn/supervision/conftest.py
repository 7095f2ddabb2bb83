"""A zygote for the tests, and the certainty that nothing of it remains after each."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from reports import Reports, Tree

from cairn.supervision.zygote_process import ZygoteProcess, start_zygote


@pytest.fixture
def tree() -> Iterator[Tree]:
    tree = Tree()
    try:
        yield tree
        tree.await_end()
    finally:
        tree.end()


@pytest.fixture
def reports(tmp_path: Path) -> Iterator[Reports]:
    with Reports(tmp_path) as reports:
        yield reports


@pytest.fixture
def zygote(tree: Tree, tmp_path: Path) -> Iterator[ZygoteProcess]:
    zygote = start_zygote(["zygote_children"], tmp_path / "run")
    yield zygote
    zygote.close()

"""A zygote for the tests, and the check that nothing of it remains after each."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from cairn.processes.launcher import ZygoteProcess, start_zygote

from . import zygote_children
from .reports import Reports, Tree
from .zygote_owner import Owner


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
    zygote = start_zygote([zygote_children.__name__], tmp_path / "run")
    yield zygote
    zygote.close()


@pytest.fixture
def make_owner(
    zygote: ZygoteProcess, reports: Reports, tmp_path: Path
) -> Iterator[Callable[[], Owner]]:
    owners: list[Owner] = []

    def make() -> Owner:
        owners.append(Owner(zygote, reports, tmp_path / "driver.log"))
        return owners[-1]

    yield make
    for owner in owners:
        owner.client.close()


@pytest.fixture
def owner(make_owner: Callable[[], Owner]) -> Owner:
    return make_owner()

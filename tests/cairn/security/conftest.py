from pathlib import Path

import pytest

from cairn.security.authority import Authority
from cairn.security.folder import VARIABLE
from tests.cairn.security.computers import new_authority


@pytest.fixture(autouse=True)
def _no_folder_of_the_user(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, str(tmp_path / "unused"))


@pytest.fixture
def authority(tmp_path: Path) -> Authority:
    return new_authority(tmp_path / "authority")

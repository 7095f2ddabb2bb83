"""Peers that are not ours: where they find the definitions of the types."""

import subprocess
from pathlib import Path

import pytest

from cairn.testing.launching import CAIRN, LIMIT_S


@pytest.fixture(scope="session")
def ament(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with all definitions and type descriptions, for AMENT_PREFIX_PATH."""
    folder = tmp_path_factory.mktemp("ament")
    subprocess.run([CAIRN, "schema", "export", folder], check=True, timeout=LIMIT_S)
    return folder

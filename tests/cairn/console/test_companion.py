"""The console that runs beside `cairn up`."""

from __future__ import annotations

import queue
import urllib.request
from pathlib import Path

import psutil
import pytest

from cairn.console.companion import console_beside
from cairn.testing.launching import new_endpoint
from tests.patience import LIMIT_S

pytestmark = pytest.mark.processes


def test_console_serves_its_page_at_the_reported_address_until_the_run_ends(tmp_path: Path) -> None:
    addresses: queue.Queue[str] = queue.Queue()
    notes: list[str] = []
    before = set(psutil.Process().children())

    with console_beside(new_endpoint(), 0, tmp_path / "log", addresses.put, notes.append):
        address = addresses.get(timeout=LIMIT_S)
        (process,) = set(psutil.Process().children()) - before
        with urllib.request.urlopen(address.partition("#")[0], timeout=LIMIT_S) as page:
            assert b"<html" in page.read()

    assert not process.is_running()
    assert notes == []
    assert "#token=" not in (tmp_path / "log").read_text()


def test_console_that_ends_is_reported_and_does_no_harm(tmp_path: Path) -> None:
    addresses: queue.Queue[str] = queue.Queue()
    notes: queue.Queue[str] = queue.Queue()
    before = set(psutil.Process().children())

    with console_beside(new_endpoint(), 0, tmp_path / "log", addresses.put, notes.put):
        addresses.get(timeout=LIMIT_S)
        (process,) = set(psutil.Process().children()) - before
        process.kill()
        assert "the robot goes on" in notes.get(timeout=LIMIT_S)

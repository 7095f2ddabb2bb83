"""A supplier of files: each hostile file is refused with its reason, within time and memory."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache

import pytest

from tests.hostile_files import HOSTILE
from tests.hostile_reading import MOST_MEMORY_MB, MOST_SECONDS, Outcome, read_all


@cache
def _outcomes(kind: str) -> dict[str, Outcome]:
    return read_all(f"{kind}/{name}" for name in HOSTILE[kind])


@pytest.fixture
def outcome(kind: str, name: str) -> Outcome:
    """How reading the file ended."""
    return _outcomes(kind)[f"{kind}/{name}"]


@pytest.mark.parametrize(
    ("kind", "name"), [(kind, name) for kind, files in HOSTILE.items() for name in files]
)
def test_hostile_file_is_refused(
    kind: str, name: str, outcome: Outcome, record_property: Callable[[str, object], None]
) -> None:
    record_property("seconds", outcome.seconds)
    record_property("peak_mb", outcome.peak_mb)

    assert outcome.error == "CairnError", outcome
    assert re.search(HOSTILE[kind][name].reason, outcome.text), outcome
    assert outcome.seconds <= MOST_SECONDS
    assert outcome.peak_mb <= MOST_MEMORY_MB

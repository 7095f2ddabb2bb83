"""The pytest plugin of the lab: `pytest_plugins = ["cairn_lab.testing"]` in a conftest.py."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from cairn_lab.campaign.report import CampaignReport


@pytest.fixture
def campaign(tmp_path: Path) -> Callable[..., CampaignReport]:
    """Run campaigns: `campaign(deployment, faults, invariants, ...)` returns the report.

    `deployment` is a file, the name of a shipped deployment, or a text with its keys. Faults and
    invariants are given by name, or as in a campaign file; an invariant also as an object. Further
    arguments are keys of a campaign file. By default 10 faults are injected, one a second, and the
    last 60 s before each violation are recorded.
    """
    from cairn_lab.campaign.fixture import (
        CampaignRuns,  # takes a second: only for tests that use it
    )

    return CampaignRuns(tmp_path)

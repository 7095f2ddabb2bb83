"""The test in the guide to campaigns runs as shown."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from cairn_lab.campaign import CampaignReport
from lab_tests.campaign.test_campaign import TREE
from tests.docs.conftest import blocks


@pytest.mark.accuracy
@pytest.mark.processes
def test_example_of_the_guide_runs(
    campaign: Callable[..., CampaignReport],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    example = next(one for one in blocks("docs/how-to/campaign.md") if "KeepsT" in one.text)
    (tmp_path / "rover.yaml").write_text(TREE, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}

    exec(example.text, names)

    names["test_robot_survives_kills"](campaign)

"""The stop button of docs/drivers/base.md stops the robot of its overlay."""

import re
import sys
from pathlib import Path

import pytest

from cairn import CairnError
from cairn.schemas.cairn_nav_msgs import VelocityGateStatus
from cairn.testing.lockstep import DeploymentHarness

ROOT = Path(__file__).parents[3]


def block(title: str) -> str:
    fence = rf'^```\w+ title="{re.escape(title)}"\n(.*?)^```'
    page = (ROOT / "docs" / "drivers" / "base.md").read_text(encoding="utf-8")
    (found,) = re.findall(fence, page, re.DOTALL | re.MULTILINE)
    return str(found)


def test_button_of_the_page_engages_the_emergency_stop(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "stop_button.py").write_text(block("stop_button.py"))
    overlay, pin = tmp_path / "stop_button.yaml", tmp_path / "pin"
    overlay.write_text(block("stop_button.yaml"))
    monkeypatch.syspath_prepend(tmp_path)
    sets = [f"settings.report={tmp_path}", f"components.stop_button.parameters.pin={pin}"]
    pin.write_text("1\n")
    try:
        with DeploymentHarness(ROOT / "deploy" / "sim.yaml", overlays=[overlay], sets=sets) as sim:
            statuses = sim.read("velocity_gate_status", VelocityGateStatus).messages
            sim.run_for(2.0)
            assert not statuses[-1].stopped
            pin.write_text("0\n")
            sim.run_for(0.2)
            assert statuses[-1].emergency_stop
            with pytest.raises(CairnError, match="release the button first"):
                sim.request("velocity_gate", "release_stop")
            pin.write_text("1\n")
            sim.run_for(0.2)
            assert statuses[-1].emergency_stop
            sim.request("velocity_gate", "release_stop")
            sim.run_for(0.5)
            assert not statuses[-1].stopped
    finally:
        sys.modules.pop("stop_button", None)

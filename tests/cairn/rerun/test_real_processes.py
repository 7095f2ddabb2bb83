"""A recording of real processes: what drives devices is refused, the rest makes tests."""

import runpy
from pathlib import Path

import pytest

from cairn.schemas.geometry_msgs import TwistStamped
from cairn.testing.launching import Launching
from tests.cairn.rerun.walkers import Walker
from tests.commands import cairn
from tests.wording import assert_words

ROBOT = f"""
external_topics: [nothing]
components:
  first: {{plugin: "{Walker.__module__}:Walker", topics: {{position: pushes, push: nothing}}}}
  second: {{plugin: "{Walker.__module__}:Walker", topics: {{push: pushes, corner: corner2}}}}
  thermometer: {{plugin: "{Walker.__module__}:Thermometer", topics: {{position: warmth}}}}
  poller: {{plugin: "{Walker.__module__}:Poller", topics: {{position: polled}}}}
"""


@pytest.fixture
def recording(launch: Launching) -> Path:
    environment = {"PYTHONPATH": str(Path(__file__).parents[3])}
    run = launch(ROBOT, "--record", environment=environment)
    run.await_line("child active: poller")
    echo = ("topic", "echo", "polled", "--count", "10")
    assert cairn(*echo, connect=run.endpoint).code == 0
    assert run.stop() == 0
    return run.report / "recording.mcap"


@pytest.mark.accuracy
def test_recording_of_real_processes_makes_a_test_and_drivers_are_refused(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    everything = cairn("rerun", str(recording))
    assert everything.code == 0, everything
    assert "second: equal" in everything.out
    assert "poller" not in everything.out

    device = cairn("rerun", str(recording), "--component", "thermometer")
    assert device.code == 1
    assert_words(device.err, "thermometer: cannot be re-run", "it drives a device", "second")
    poller = cairn("rerun", str(recording), "--component", "poller")
    assert poller.code == 1
    assert_words(poller.out, "poller: cannot be re-run", "threads of its own", "read its topics")

    answer = cairn("rerun", str(recording), "--component", "second", "--save-test", str(tmp_path))
    assert answer.code == 0, answer
    saved = runpy.run_path(str(tmp_path / "test_second_recording.py"))
    (test,) = [value for name, value in saved.items() if name.startswith("test_")]
    recording.unlink()
    test()
    monkeypatch.setattr(Walker, "_at", lambda self, x: TwistStamped())
    with pytest.raises(AssertionError, match=r"second: /robot/\w+: header.stamp.sec is 0"):
        test()

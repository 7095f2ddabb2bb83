"""What a failed test of a contract shows: the wrong setting, or what the deployment logged."""

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from textwrap import dedent

import pytest
import zenoh

from cairn.bus import session
from cairn.testing.launching import Launching
from cairn.testing.robot import RunningDeployment

pytestmark = pytest.mark.processes

COMPONENTS = """
    import threading
    from cairn import Component, Config, Out, every
    from cairn.schemas.std_msgs import String
    from pydantic import Field

    class RingConfig(Config):
        fails: bool = Field(False, description="Whether it has a defect.")

    class Ring(Component):
        config: RingConfig
        words: Out[String] = Out()

        @every(hz=20)
        def publish(self) -> None:
            if self.config.fails:
                raise ValueError("the ring is broken on purpose")
            self.words.publish(String(data="word"))

    class Slow(Component):
        def on_configure(self) -> None:
            threading.Event().wait(60)
    """
DEPLOYMENT = """
    cairn: 1
    robot: ${name}
    settings: {name: rover, fails: false}
    supervision: {max_restarts: 1000, within_s: 1}
    components:
      driving:
        plugin: supervisor
        supervision: {max_restarts: 1000, within_s: 1}
        children:
          ring: {plugin: "ring:Ring", parameters: {fails: "${fails}"}}
    """
TESTS = """
    from pathlib import Path
    from cairn.schemas.std_msgs import String
    from cairn.testing.driver_contract import Contract

    class Published(Contract):
        deployment = Path(__file__).with_name("rover.yaml")
        component = "ring"
        port = "words"
        message = String
        rate_hz = 20.0
        return_limit_s = 60.0

        def test_words(self, output):
            self.sample(output, 3)

    class TestWorking(Published):
        sets = ("name=sonar_robot",)

        def test_name(self, robot):
            assert robot.name == "sonar_robot"

    class TestUnknown(Published):
        component = "scanner"

    class TestUnset(Contract):
        deployment = Published.deployment

        def test_robot(self, robot): ...

    class TestBroken(Published):
        sets = ("fails=true",)
        return_limit_s = 1.0
    """


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A package with components, a deployment, and tests by the contracts."""
    (tmp_path / "ring.py").write_text(dedent(COMPONENTS), encoding="utf-8")
    (tmp_path / "rover.yaml").write_text(dedent(DEPLOYMENT), encoding="utf-8")
    (tmp_path / "test_ring.py").write_text(dedent(TESTS), encoding="utf-8")
    (tmp_path / "conftest.py").write_text("pytest_plugins = ['cairn.testing.plugin']\n")
    return tmp_path


@pytest.mark.accuracy
def test_failed_contract_names_a_wrong_setting_or_shows_what_the_deployment_logged(
    folder: Path,
) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", "."],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(folder)},
        capture_output=True,
        text=True,
        timeout=200,
    )

    shown = done.stdout
    assert done.returncode == 1, shown + done.stderr  # not ended by a signal
    assert "2 passed" in shown, shown
    unknown = "TestUnknown.component = 'scanner': the deployment has no such component; it has "
    assert unknown + "driving, ring" in shown
    assert "TestUnset.component is not set" in shown
    assert re.search(r"/rover/words: expected 3 messages within [\d.]+ s, received 0", shown)
    (broken,) = re.findall("- cairn up -.*", shown, re.DOTALL)
    logs = re.search("^logs: (.*)", broken, re.MULTILINE)
    assert logs is not None
    assert (Path(logs[1]) / "ring.log").is_file()
    assert "ring.py" in broken  # the traceback
    assert "ValueError: the ring is broken on purpose" in broken


@pytest.mark.accuracy
def test_deployment_that_does_not_start_is_described_and_leaves_no_session_open(
    folder: Path, launch: Launching, monkeypatch: pytest.MonkeyPatch
) -> None:
    sessions: list[zenoh.Session] = []

    def open_peer(connect: list[str]) -> zenoh.Session:
        sessions.append(session.open_peer(connect))
        return sessions[-1]

    monkeypatch.setattr("cairn.testing.robot.open_peer", open_peer)
    components = """
        components:
          ring: {plugin: "ring:Ring"}
          slow: {plugin: "ring:Slow", stop_timeout_s: 0.2}
        """
    run = launch(components, environment={"PYTHONPATH": str(folder)})
    run.await_line("child active: ring")

    with pytest.raises(AssertionError, match=r"root is not active after 0\.3 s; ") as failure:
        RunningDeployment(run, limit_s=0.3)

    assert re.search("nothing was received from it|its last status: ", str(failure.value))
    assert f"logs: {run.logs}" in str(failure.value)
    assert [one.is_closed() for one in sessions] == [True]


@pytest.mark.accuracy
def test_status_after_a_transition_is_that_of_the_reply(
    deploy: Callable[..., RunningDeployment],
) -> None:
    robot = deploy("robot: rover\ndomain: 7\ncomponents: {talker: {plugin: test_talker}}")

    for _ in range(10):
        assert robot.request("talker", "deactivate") == robot.status("talker").state == "inactive"
        assert robot.request("talker", "activate") == robot.status("talker").state == "active"

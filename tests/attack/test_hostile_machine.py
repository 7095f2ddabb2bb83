"""A machine of the robot that was taken over attacks the first one, while that drives.

It publishes, announces and answers what its components may, but everything wrong: the first machine
neither crashes nor hangs, its memory stays bounded, and it drives on or stops with the reason. The
link is TLS, as between computers, on loopback: no cable limits what the attacker sends.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import Any

import pytest

import cairn.client
from cairn.errors import CairnError
from cairn.schemas.cairn_nav_msgs import NavigationStatus
from cairn.security.authority import Authority, AuthorityMember
from cairn.security.folder import VARIABLE, RobotFolder
from cairn.testing.launching import free_port
from tests.attack.hostile_machine import ATTACKS
from tests.commands import cairn as command
from tests.navigation.processes import ObservedRobot, robot_in
from tests.patience import LIMIT_S

MOST_MEMORY_MB = 500.0
"""No process of the attacked machine may use more [MB]."""

_GOALS = ((2.2, 1.2, 0.0), (1.0, 1.0, 0.0))
_OVERLAY = """
machines:
  base: {{address: 127.0.0.1, port: {base}}}
  brain: {{address: 127.0.0.1, port: {brain}}}
components:
  mobile_supervisor:
    children:
      automove:
        children:
          localizer: {{machine: brain, fallback: {{}}, start_timeout_s: 1}}
  vision_supervisor: {{machine: brain, start_timeout_s: 1}}
"""
_ASTRAY_S = 20.0
"""So long [s] the robot tries to drive without a pose, or with a wrong one."""
_ASTRAY = ("poses", "replies", "flapping", "lies")
"""Attacks in which the robot has no pose or a wrong one, and may still be on its way when
`_ASTRAY_S` are over."""
_ON_ITS_WAY = (NavigationStatus.PLANNING, NavigationStatus.DRIVING)


class Attacked:
    """The first machine of a robot whose second one is hostile."""

    def __init__(self, observed: ObservedRobot, client: cairn.client.Robot, links: Any) -> None:
        self.observed = observed
        self._client = client
        self._links = links
        self._goals = 0
        self.reach_goal()
        self.pids = self._components()

    def reach_goal(self) -> None:
        """Drive to the next goal; the robot must reach it."""
        end = self.drive(LIMIT_S)
        assert end.state == NavigationStatus.SUCCEEDED, (end, self.observed.run)

    def drive(self, limit_s: float) -> NavigationStatus:
        """Drive to the next goal for at most `limit_s` [s]; return the last status."""
        goal = _GOALS[self._goals % len(_GOALS)]
        self._goals += 1
        last = NavigationStatus()
        with self._client.go(*goal) as mission:
            try:
                for last in mission.progress(limit_s):  # noqa: B007 - the last one is returned
                    pass
            except CairnError:
                mission.cancel()
        return last

    @contextmanager
    def attack(self, name: str) -> Iterator[dict[str, Any]]:
        """Run an attack; yield what has been sent, which is complete afterward."""
        endpoint, identity = self._links
        program = subprocess.Popen(
            [sys.executable, "-m", "tests.attack.hostile_machine", name, endpoint, identity],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert program.stdout is not None
        sent: dict[str, Any] = {}
        try:
            assert json.loads(program.stdout.readline()) == {}  # it begins
            yield sent
            sent |= json.loads(program.communicate(timeout=LIMIT_S)[0])
        finally:
            program.kill()
            program.wait()

    def peaks(self) -> dict[str, float]:
        """Return the highest memory use [MB] of each process of the run so far."""
        found = {}
        for process in self.observed.run.processes():
            lines = Path(f"/proc/{process.pid}/status").read_text(encoding="ascii").splitlines()
            (peak,) = [line.split()[1] for line in lines if line.startswith("VmHWM")]
            found[process.cmdline()[0].removeprefix("cairn: ")] = int(peak) / 1024
        return found

    def replaced(self) -> list[str]:
        """Return the components that have another process than at the beginning."""
        now = self._components()
        return [name for name, pid in self.pids.items() if now.get(name) != pid]

    def _components(self) -> dict[str, int]:
        run = self.observed.run
        return {
            process.cmdline()[0].removeprefix("cairn: "): process.pid
            for process in run.processes()
            if process.cmdline()[0].startswith("cairn: ")
            and "localizer" not in process.cmdline()[0]  # it comes and goes with the machine
        }


@pytest.fixture(scope="module")
def attacked(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Attacked]:
    folder = tmp_path_factory.mktemp("machines")
    port = free_port()
    overlay = folder / "machines.yaml"
    overlay.write_text(_OVERLAY.format(base=port, brain=free_port()))
    with ExitStack() as stack:
        patch = stack.enter_context(pytest.MonkeyPatch.context())
        patch.setenv(VARIABLE, str(folder / "security"))
        members = [AuthorityMember(name, None, ("127.0.0.1",)) for name in ("base", "brain")]
        Authority.create(RobotFolder.of("robot"), members)
        identity = RobotFolder.of("robot").path / "identities" / "brain"
        until = "active: mobile_supervisor"
        observed = stack.enter_context(
            robot_in(folder, overlays=[overlay], machine="base", until=until)
        )
        client = stack.enter_context(closing(cairn.client.connect(observed.run.endpoint)))
        yield Attacked(observed, client, (f"tls/127.0.0.1:{port}", str(identity)))


@pytest.mark.parametrize("name", ATTACKS)
def test_hostile_machine_does_not_stop_the_first_one(
    attacked: Attacked, name: str, record_property: Callable[[str, object], None]
) -> None:
    with attacked.attack(name) as sent:
        end = attacked.drive(_ASTRAY_S if name in _ASTRAY else LIMIT_S)
        began = time.monotonic()
        answer = command("ps", "--json", connect=attacked.observed.run.endpoint)
        record_property("seconds", time.monotonic() - began)  # until the operator sees all
    counts = {
        row["component"].rpartition("/")[2]: (row["received"], row["dropped"], row["invalid"])
        for row in answer.json
    }
    peaks = attacked.peaks()
    record_property("peak_mb", max(peaks.values()))
    figures = {"sent": sent, "state": end.state, "reason": end.reason, "peaks": peaks, "ps": counts}
    record_property("figures", json.dumps(figures))
    assert sum(sent.values()) - sent["seconds"] >= ATTACKS[name], sent
    assert counts.keys() >= attacked.pids.keys() - {"zygote"}
    assert (attacked.observed.collisions, attacked.replaced()) == ([], [])
    assert max(peaks.values()) <= MOST_MEMORY_MB
    if end.state != NavigationStatus.SUCCEEDED:
        assert end.reason or (name in _ASTRAY and end.state in _ON_ITS_WAY), end
    attacked.reach_goal()


def test_afterward_the_attacked_machine_is_unharmed(attacked: Attacked) -> None:
    attacked.reach_goal()
    assert (attacked.observed.collisions, attacked.replaced()) == ([], [])

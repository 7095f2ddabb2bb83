"""The simulated robot under attack: what it has counted and logged, and that it is unharmed."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import psutil
import zenoh

import cairn.client
from cairn.bus.credentials import NO_CREDENTIALS, Credentials
from cairn.bus.session import open_client
from cairn.schemas.cairn_msgs import ComponentStatus, PortStatus
from cairn.schemas.cairn_nav_msgs import NavigationStatus
from cairn.testing.launching import free_port
from tests.attack.inputs import Topic, components, deployment, invalid, topics
from tests.navigation.processes import ObservedRobot, robot_in
from tests.patience import LIMIT_S

MOST_SECONDS: Final = 5.0
"""Within this time [s] each attack must have been refused: `conftest.py` judges it."""

MOST_MEMORY_MB: Final = 500.0
"""No process may use more memory [MB]."""

_GOALS: Final = ((2.2, 1.2, 0.0), (1.0, 1.0, 0.0))
_GOAL_LIMIT_S: Final = 60.0
_START_LIMIT_S: Final = 30.0


@dataclass(frozen=True)
class Harm:
    """What attacks have done to a robot: collisions, processes that were replaced, and memory."""

    collisions: int
    replaced: list[str]
    peak_mb: float


class AttackedRobot:
    """A running simulated robot; attackers connect to `endpoint`, its own user by `client`."""

    def __init__(self, observed: ObservedRobot, endpoint: str, client: cairn.client.Robot) -> None:
        self.run = observed.run
        self.endpoint = endpoint
        self.client = client
        self._observed = observed
        self._goals = 0
        self._waited_s = 0.0
        self._changed = threading.Condition(threading.RLock())
        self._statuses: dict[str, ComponentStatus] = {}
        self._received: dict[str, int] = dict.fromkeys(components(), 0)
        client.subscribe("/robot/component_status", ComponentStatus, self._note)
        self.reach_goal()  # loads the components that start on request
        self._wait(lambda: set(components()) <= set(self._statuses), _START_LIMIT_S)
        self.pids = {
            member.name: self.run.pid_of(member.name)
            for member in deployment().members()
            if member.spec.placement == "process"
        }

    def attacker(self, credentials: Credentials = NO_CREDENTIALS) -> zenoh.Session:
        """Open the session of a peer that does not know the secret of the run."""
        return open_client([self.endpoint], credentials)

    def ports(self, topic: Topic) -> list[PortStatus]:
        """Return the counters of all inputs of a topic, as last published."""
        with self._changed:
            return [self._port(component, port) for component, port in topic.readers]

    def await_counts(
        self, topics: Iterable[Topic], holds: Callable[[PortStatus, PortStatus], bool]
    ) -> None:
        """Wait until `holds(before, now)` for every input of the topics."""
        before = {topic: self.ports(topic) for topic in topics}

        def late() -> list[str]:
            return [
                f"{topic.name} of {component}"
                for topic, ports in before.items()
                for (component, _), was, now in zip(
                    topic.readers, ports, self.ports(topic), strict=True
                )
                if not holds(was, now)
            ]

        with self._changed:
            in_time = self._changed.wait_for(lambda: not late(), LIMIT_S)
            assert in_time, f"not rejected within {LIMIT_S:g} s: {late()}"

    def next_statuses(self) -> None:
        """Wait until every component has published its status once more."""
        begin = time.monotonic()
        with self._changed:
            before = dict(self._received)
        # Twice: the first one may have been made before this call.
        self._wait(
            lambda: all(self._received[name] >= count + 2 for name, count in before.items()),
            LIMIT_S,
        )
        self._waited_s += time.monotonic() - begin

    def take_waited_s(self) -> float:
        """Return how long `next_statuses` has waited since the last call of this function [s]."""
        waited_s, self._waited_s = self._waited_s, 0.0
        return waited_s

    def await_log(self, component: str, pattern: str) -> None:
        """Wait until a component has logged a line with this pattern."""
        deadline = time.monotonic() + LIMIT_S
        while not re.search(pattern, self.run.log_of(component)):
            assert time.monotonic() < deadline, f"{component} has not logged {pattern!r}"
            threading.Event().wait(0.02)

    def reach_goal(self) -> None:
        """Drive to the next goal; the robot must reach it."""
        goal = _GOALS[self._goals % len(_GOALS)]
        self._goals += 1
        with self.client.go(*goal) as mission:
            result = mission.result(_GOAL_LIMIT_S)
        assert result.state == NavigationStatus.SUCCEEDED, result

    def harm(self) -> Harm:
        """Return what the attacks so far have done."""
        running = {psutil.Process(pid).cmdline()[0].removeprefix("cairn: "): pid
                   for pid in self.run.pids() if pid != self.run.process.pid}  # fmt: skip
        replaced = [name for name, pid in self.pids.items() if running.get(name) != pid]
        peaks = self._peaks()
        return Harm(len(self._observed.collisions), replaced, max(peaks.values()))

    def _peaks(self) -> Mapping[int, float]:
        """Return the highest memory use [MB] of each process since its start."""
        found = {}
        for pid in self.run.pids():
            status = Path(f"/proc/{pid}/status").read_text(encoding="ascii")
            peak = re.search(r"VmHWM:\s+(\d+) kB", status)
            found[pid] = int(peak[1]) / 1024 if peak else 0.0
        return found

    def _port(self, component: str, port: str) -> PortStatus:
        ports = self._statuses[component].ports
        return next(one for one in ports if one.port == port and one.direction == one.IN)

    def _note(self, status: ComponentStatus) -> None:
        with self._changed:
            self._statuses[status.component] = status
            if status.component in self._received:
                self._received[status.component] += 1
            self._changed.notify_all()

    def _wait(self, holds: Callable[[], bool], limit_s: float) -> None:
        with self._changed:
            assert self._changed.wait_for(holds, limit_s), f"not within {limit_s:g} s"


@contextmanager
def attacked_robot(folder: Path, bus: str) -> Iterator[AttackedRobot]:
    """Start the simulated robot with an endpoint for attackers; `bus` are further settings."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    for topic in topics().values():
        invalid(topic)  # computed once, and not within the time of a case
    with (
        robot_in(folder, f"bus.listen=[{endpoint}]", *bus.split(";")) as observed,
        closing(cairn.client.connect(observed.run.endpoint)) as client,
    ):
        yield AttackedRobot(observed, endpoint, client)

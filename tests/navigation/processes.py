"""The simulated robot in real processes: goals by `cairn go`, and the ground truth."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from cairn import RELIABLE
from cairn.bus.session import open_peer
from cairn.bus.zenoh_bus import ZenohBus
from cairn.planar.messages import planar_pose
from cairn.planar.poses import Pose, distance
from cairn.schemas.cairn_nav_msgs import Collision
from cairn.schemas.geometry_msgs import PoseStamped
from cairn.testing.launching import CAIRN, LIMIT_S, Run, launching, new_endpoint
from tests.disk import open_to_others
from tests.navigation.driving import SIM

UNTIL_READY = "child active: vision_supervisor"


class ObservedRobot:
    """A running robot in the simulated world, observed from outside."""

    def __init__(self, run: Run, bus: ZenohBus) -> None:
        self.run = run
        self.collisions: list[Collision] = []
        self._truths: list[tuple[float, Pose]] = []
        self._changed = threading.Condition()
        node = bus.node("/examiner", print)
        with self._changed:  # the first message may come before the subscription is known here
            self._truth = node.subscribe("/robot/truth", PoseStamped, RELIABLE, self._follow)
            self._collision = node.subscribe("/robot/collisions", Collision, RELIABLE, self._note)

    @property
    def pose(self) -> Pose:
        """The robot's true pose."""
        with self._changed:
            assert self._changed.wait_for(lambda: bool(self._truths), LIMIT_S), self.run
            return self._truths[-1][1]

    def path(self) -> list[Pose]:
        """Return the robot's true poses so far."""
        with self._changed:
            return [pose for _, pose in self._truths]

    def go(self, *words: str) -> RunningGo:
        """Start `cairn go`, as from a terminal."""
        return RunningGo([*words, "--connect", self.run.endpoint])

    def kill(self, component: str) -> None:
        """Kill a component's process."""
        os.kill(self.run.pid_of(component), signal.SIGKILL)

    def await_moved(self, meters: float) -> None:
        """Wait until the robot is `meters` away from its present position."""
        begin = self.pose
        self._await(lambda: distance(begin, self._truths[-1][1]) >= meters, "moves")

    def await_stand(self) -> None:
        """Wait until the robot has stood for 0.25 s."""
        since = time.monotonic()

        def stands() -> bool:
            truths = [(at, pose) for at, pose in self._truths if at >= since]
            for number, (at, pose) in enumerate(truths):
                later = [other for when, other in truths[number:] if when - at >= 0.25]
                if later and distance(pose, later[0]) < 0.005:
                    return True
            return False

        self._await(stands, "stands")

    def _await(self, condition: Callable[[], bool], event: str) -> None:
        with self._changed:
            assert self._changed.wait_for(condition, LIMIT_S), (
                f"not within {LIMIT_S} s: {event}; {self.run}"
            )

    def _follow(self) -> None:
        with self._changed:
            while (truth := self._truth.take()) is not None:
                self._truths.append((time.monotonic(), planar_pose(truth.pose)))
            self._changed.notify_all()

    def _note(self) -> None:
        with self._changed:
            while (collision := self._collision.take()) is not None:
                self.collisions.append(collision)


class RunningGo:
    """A running `cairn go`: its output lines and its end."""

    def __init__(self, arguments: list[str], **options: Any) -> None:
        self.lines: list[str] = []
        self.process = subprocess.Popen(
            [CAIRN, "go", *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            text=True,
            env={**os.environ, "PYTHONUNBUFFERED": "1"},
            **options,
        )
        self._changed = threading.Condition()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def await_output(self, word: str) -> None:
        """Wait until it has printed a line with this text."""
        with self._changed:
            found = self._changed.wait_for(
                lambda: any(word in line for line in self.lines), LIMIT_S
            )
        assert found, f"no {word!r} within {LIMIT_S} s; {self}"

    def await_end(self) -> int:
        """Wait for its end and return its exit code."""
        try:
            code = self.process.wait(LIMIT_S)
        except subprocess.TimeoutExpired:
            raise AssertionError(f"it does not end within {LIMIT_S} s; {self}") from None
        self._reader.join(LIMIT_S)
        return code

    def __str__(self) -> str:
        return "it printed:\n" + "".join(self.lines)

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            with self._changed:
                self.lines.append(line)
                self._changed.notify_all()
        self.process.stdout.close()


@contextmanager
def robot_in(
    folder: Path,
    *sets: str,
    deployment: Path = SIM,
    overlays: Sequence[Path] = (),
    until: str = UNTIL_READY,
    machine: str = "",
) -> Iterator[ObservedRobot]:
    """Start the deployment, wait for a line of its output, and stop all of it at the end.

    `machine` is the one of the robot that runs, if it has several.
    """
    with launching(folder) as launch:
        endpoint = new_endpoint()
        state_file = "components.mobile_supervisor.parameters.state_file=${report}/mission.json"
        changes = [f"bus.socket={endpoint}", state_file, *sets]
        arguments = [str(deployment), *(word for one in changes for word in ("--set", one))]
        arguments += [word for one in overlays for word in ("--overlay", str(one))]
        arguments += ["--machine", machine] if machine else []
        run = Run(arguments, folder / "report", endpoint, {}, None, umask=0)
        launch.runs.append(run)
        run.await_line(until)
        bus = ZenohBus(open_peer([endpoint]))
        try:
            yield ObservedRobot(run, bus)
        finally:
            with contextlib.suppress(Exception):
                bus.close()
        assert open_to_others(run.report) == []

"""Silent peers, ghost tokens and false queryables: what they delay.

    python -m cairn_lab.benchmarks silent_peers

Programs without rights join the router of the simulated robot: sessions that answer nothing, some
of them in stopped processes, queryables that never answer on the keys of requests and
discovery, and liveliness tokens of components that do not exist. The same operations are timed
without and with them; each may take at most 1 s longer.
"""

import argparse
import math
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import zenoh

import cairn.client
from cairn.bus import keys, session
from cairn.bus.qos import LATCHED
from cairn.bus.type_hash import type_hash
from cairn.deployment.shipped import FOLDER
from cairn.errors import CairnError
from cairn.schemas.cairn_msgs import ComponentStatus
from cairn.schemas.cairn_nav_msgs import NavigateGoal, VelocityGateStatus
from cairn.schemas.message import type_name
from cairn.schemas.rcl_interfaces import Log
from cairn.testing.launching import Launching, Run, launching, new_socket
from cairn_lab.benchmarks.result import Metric

PEERS = 40
"""Silent sessions, a fifth of them in processes that are stopped."""
GHOSTS = 10_000
"""Liveliness tokens of nodes and publishers that do not exist; the worse ones are described in
`docs/concepts/security.md`."""
LIMIT_S = 1.0
"""Nothing may be delayed by more."""

_STOPPED_PROCESSES = 2
_GHOSTS_PER_SESSION = 1000
"""Declaring a token takes a time in proportion to those that its session has."""
_FALSE_KEYS = (
    keys.session_key("*"),
    "@cairn/0/component/**",
)
_READY = "ready"


def silent_session(endpoint: str) -> zenoh.Session:
    """Open the session of a peer that answers nothing, with queryables that never answer."""
    opened = session.open_peer([endpoint], secret="not of the run")
    _KEPT.append(opened)
    for key in (*_FALSE_KEYS, keys.session_key(str(opened.info.zid()))):
        queryable: Any = opened.declare_queryable(key, zenoh.handlers.RingChannel(16))
        _KEPT.append(queryable)
    return opened


_KEPT: list[Any] = []  # an object that is released is undeclared


def declare_ghosts(opened: zenoh.Session, first: int, count: int) -> None:
    """Declare tokens of components and their publishers, of the robot and of others."""
    zid = str(opened.info.zid())
    types = (ComponentStatus, Log, NavigateGoal, VelocityGateStatus)
    for number in range(first, first + count):
        robot = "robot" if number % 2 else f"robot{number}"
        node = keys.NodeEntity(0, zid, number, f"/{robot}/ghost{number}")
        entity: keys.NodeEntity | keys.EndpointEntity = node
        if number % 5:
            message = types[number % 5 - 1]
            topic = "/rosout" if message is Log else f"/{robot}/{_TOPICS[number % 5 - 1]}"
            entity = keys.EndpointEntity(
                node, number, "MP", topic, type_name(message), type_hash(message), LATCHED
            )
        _KEPT.append(opened.liveliness().declare_token(keys.token_key(entity)))
    root = keys.token_key(keys.NodeEntity(0, zid, first + count, "/robot/root"))
    _KEPT.extend((opened, opened.liveliness().declare_token(root)))


_TOPICS = ("component_status", "rosout", "navigate_goal", "velocity_gate_status")


def attack(endpoint: str, peers: int, ghosts: int) -> None:
    """Join as that many silent peers and stay until this process is killed."""
    session.LEASE_MS = 3_600_000  # the links outlast the time for which a process is stopped
    for _ in range(peers):
        silent_session(endpoint)
    for first in range(0, ghosts, _GHOSTS_PER_SESSION):
        count = min(_GHOSTS_PER_SESSION, ghosts - first)
        declare_ghosts(session.open_client([endpoint]), first, count)
    sys.stdout.write(f"{_READY}\n")
    sys.stdout.flush()
    signal.pause()


@contextmanager
def attacked(endpoint: str, peers: int, ghosts: int) -> Iterator[None]:
    """Have silent peers on the router at an endpoint."""
    stopped = peers // 5
    shares = [(peers - stopped, ghosts)]
    shares += [(stopped // _STOPPED_PROCESSES, 0)] * (_STOPPED_PROCESSES if stopped else 0)
    with ExitStack() as stack:
        for number, (count, tokens) in enumerate(shares):
            words = ["--attack", endpoint, str(count), str(tokens)]
            process = stack.enter_context(
                subprocess.Popen(
                    [sys.executable, "-m", "cairn_lab.benchmarks.silent_peers", *words],
                    stdout=subprocess.PIPE,
                    text=True,
                )
            )
            stack.callback(process.kill)
            assert process.stdout is not None
            if process.stdout.readline().strip() != _READY:
                raise RuntimeError("the silent peers cannot join")
            if number:
                process.send_signal(signal.SIGSTOP)
        yield


def timed(call: Callable[[], object]) -> float:
    """Return how long a call takes [s]; infinite if it fails."""
    begin = time.monotonic()
    try:
        call()
    except CairnError as error:
        print(f"failed after {time.monotonic() - begin:.1f} s: {error}")
        return math.inf
    return time.monotonic() - begin


def operations(run: Run) -> dict[str, float]:
    """Return the times of the operations of a user on a running robot [s]."""
    with cairn.client.connect(run.endpoint, robot="robot") as robot:
        times = {
            "ps": timed(robot.connection.read_statuses),
            "logs": timed(lambda: robot.logs("localizer")),
            "stop": timed(robot.stop),
            "stop --release": timed(robot.release_stop),
        }
        began = time.monotonic()
        goal = robot.go(7.5, 5.0)
        times["go"] = time.monotonic() - began
        next(iter(goal))
        times["go, first status"] = time.monotonic() - began
        times["go --cancel"] = timed(goal.cancel)
        goal.close()
        times["restart"] = timed(lambda: robot.restart("localizer"))
    return times


def start(launch: Launching, endpoint: str) -> tuple[Run, float]:
    """Start the robot on the router at an endpoint; return how long it took, too [s]."""
    began = time.monotonic()
    run = launch(FOLDER / "sim.yaml", "--plain", connect=endpoint)
    run.await_line("child active: mobile_supervisor", limit_s=100)
    return run, time.monotonic() - began


def measured(launch: Launching, endpoint: str) -> dict[str, float]:
    """Return the times of a start on the router at an endpoint, and of the operations [s]."""
    run, started = start(launch, endpoint)
    with cairn.client.connect(endpoint, robot="robot") as robot:
        robot.load("automove")
        goal = robot.go(1.6, 1.2)  # loads the children of AutoMove
        for status in goal:
            if status.state > status.LOCALIZING:
                break
        goal.cancel()
    times = {"start": started, **operations(run)}
    run.stop()
    return times


def measure(peers: int = PEERS, ghosts: int = GHOSTS) -> list[Metric]:
    """Measure each operation without and with the silent peers."""
    with tempfile.TemporaryDirectory() as folder, launching(Path(folder)) as launch:
        socket = new_socket()
        router = session.open_router(socket)
        try:
            endpoint = f"unixsock-stream/{socket}"
            start(launch, endpoint)[0].stop()  # the first start compiles
            before = measured(launch, endpoint)
            with attacked(endpoint, peers, ghosts):
                after = measured(launch, endpoint)
        finally:
            router.close()
    return [
        Metric(
            f"{name}: delay",
            after[name] - before[name],
            "s",
            LIMIT_S,
            note=f"{before[name]:.2f} s without",
        )
        for name in before
    ]


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--attack", nargs=3, metavar=("ENDPOINT", "PEERS", "GHOSTS"))
    parser.add_argument("--peers", type=int, default=PEERS)
    parser.add_argument("--ghosts", type=int, default=GHOSTS)
    options = parser.parse_args()
    if options.attack:
        attack(options.attack[0], int(options.attack[1]), int(options.attack[2]))
    else:
        for one in measure(options.peers, options.ghosts):
            print(one)

"""The methods that browsers call, and the events that they receive.

Each method has a model of its arguments, by which the hub checks them before the call, and from
which it describes the method to clients of Foxglove as a service. What changes something needs the
console's operator's lease of the robot, except the emergency stop. On the bus, the roles and the
velocity gate decide, as for every client.
"""

from __future__ import annotations

import asyncio
import functools
import math
import time
from collections import defaultdict
from collections.abc import Awaitable, Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, Protocol, TypeVar

from pydantic import BaseModel, ConfigDict, Field

from cairn.bus.codec import to_plain
from cairn.client import Connection, ControlError, NoReplyError, Robot
from cairn.client.velocity_gate import find_gate
from cairn.console.browser import Browser
from cairn.console.monitoring import ProcessMonitor, StateEvents
from cairn.console.operator_lease import Operator, OperatorLeases
from cairn.console.protocol import WARNING
from cairn.console.teleoperation import STILL, Driver
from cairn.errors import CairnError
from cairn.schemas.cairn_nav_msgs import MAX_GOALS, MAX_ZONE_NAME
from cairn.schemas.geometry_msgs import (
    Point,
    Pose,
    PoseWithCovariance,
    PoseWithCovarianceStamped,
    Quaternion,
)
from cairn.schemas.std_msgs import Header

if TYPE_CHECKING:
    from cairn.console.hub import Hub

R = TypeVar("R")

LIVE_METHODS: Final = (
    "acquire_lease", "release_lease", "ask_lease", "answer_lease", "go", "cancel", "locate",
    "stop", "release_stop", "drive", "restart", "load", "unload", "parameters", "set_parameters",
    "logs", "world", "why", "zones", "proposals",
)  # fmt: skip
"""The methods of a console of running robots."""

_REPLY_LIMIT_S: Final = 10.0
_PROBE_S: Final = 1.0
_VELOCITY_GATE: Final = "velocity_gate"
_VIEW_ONLY: Final = (
    "the role of this console's user on the network allows to watch only; start the console with "
    "the name of another user (CAIRN_USER)"
)
_GATE_ATTEMPTS: Final = 3  # to read its limits: the computer may be busy
_WORLD, _MAP_BUILDER, _OBJECT_FINDER = "simulated_world", "map_builder", "object_finder"
_MISSING: Final = {
    _WORLD: "this robot is not simulated",
    _MAP_BUILDER: "load the map builder, or send a goal, which loads it",
    _OBJECT_FINDER: "this robot finds no objects",
}
_POSE_TOPIC: Final = "initialpose"
_PERIOD_S: Final = 1.0
_WORKERS: Final = 16
_MOST_AT_ONCE: Final = 4  # calls of one browser that wait for the robot
_STOP_WORKERS: Final = 4
_GATE_LIMIT_S: Final = 8.0  # to find the gate and to acquire its lease

Name = Annotated[str, Field(min_length=1, max_length=200)]
PlaceName = Annotated[str, Field(min_length=1, max_length=MAX_ZONE_NAME)]
Coordinate = Annotated[float, Field(ge=-1e6, le=1e6)]
Heading = Annotated[float, Field(ge=-1e3, le=1e3)]
# No characters that control a terminal, or the direction of a text.
OperatorName = Annotated[str, Field(min_length=1, max_length=40, pattern=r"^\P{C}*$")]


class Arguments(BaseModel):
    """What a method is called with; other keys are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class OfRobot(Arguments):
    """A robot."""

    robot: Name


class OfComponent(OfRobot):
    """A component of a robot."""

    component: Name


class ParameterChanges(OfComponent):
    """New values of parameters, by dotted name."""

    values: Annotated[dict[str, Any], Field(min_length=1, max_length=1000)]


class GoRequest(OfRobot):
    """Goals [x, y, heading] in frame map [m, m, rad] or places by name, one after the other."""

    poses: Annotated[
        list[tuple[Coordinate, Coordinate, Heading] | PlaceName],
        Field(min_length=1, max_length=MAX_GOALS),
    ]


class LocateRequest(OfRobot):
    """The robot's pose in frame map [m, m, rad], to about half a meter and 15 degrees."""

    x: Coordinate
    y: Coordinate
    theta: Heading = 0.0


class StopRequest(OfRobot):
    """The emergency stop, with the reason that everyone sees."""

    reason: Annotated[str, Field(max_length=200)] = ""


class LeaseRequest(OfRobot):
    """The lease, with the name of the operator that the others see."""

    name: OperatorName | None = None


class LeaseAnswer(OfRobot):
    """Whether the one who asks gets the lease."""

    grant: bool


class DriveRequest(OfRobot):
    """Speed [m/s] and turn rate [rad/s]; `stamp` of the last answer, null in the first call."""

    speed: Annotated[float, Field(ge=-10, le=10)] = 0.0
    turn: Annotated[float, Field(ge=-20, le=20)] = 0.0
    stamp: int | None = None


class WorldRequest(OfRobot):
    """A request to the simulated world, as `cairn world` makes it."""

    verb: Literal["list", "move", "remove", "furniture", "object", "person", "kidnap"]
    arguments: Annotated[dict[str, Any], Field(max_length=20)] = {}


class ZonesRequest(OfRobot):
    """A request about the zones on the map, as the map builder answers it."""

    verb: Literal["zones", "set_zones", "add_zone", "remove_zone"]
    arguments: Annotated[dict[str, Any], Field(max_length=2)] = {}


class ProposalsRequest(OfRobot):
    """A request to accept or reject a thing that the object finder proposes."""

    verb: Literal["accept", "reject"]
    arguments: Annotated[dict[str, Any], Field(max_length=2)]


class WhyRequest(OfRobot):
    """An object of the visual map, by number or name, and the number of newest steps."""

    object_id: int | Name
    last: Annotated[int, Field(ge=1, le=1000)] = 30


@dataclass(frozen=True)
class ConsoleMethod:
    """A method of the console.

    Attributes:
        arguments: model of its arguments.
        call: called with the browser and valid arguments; returns what JSON can hold, or raises
            `CairnError`.
        changes: whether it changes anything; the hub refuses it for browsers that only watch.
        is_service: whether clients of Foxglove get it as a service, one for each robot.
    """

    arguments: type[Arguments]
    call: Callable[[Browser, Any], Awaitable[Any]]
    changes: bool = True
    is_service: bool = False


class ConsoleOperations(Protocol):
    """What a hub offers to browsers beside topics. For the event loop's thread."""

    methods: Mapping[str, ConsoleMethod]

    async def run(self) -> None:
        """Send the events that come at intervals, until canceled."""

    def connected(self, browser: Browser) -> None:
        """Send a new browser what it does not get otherwise."""

    def disconnected(self, browser: Browser) -> None:
        """Stop what a browser was doing, such as driving."""

    def refusal(self, browser: Browser, robot: str) -> str:
        """Return why a browser may not publish to a robot now; "" if it may."""


class Operations:
    """The methods and events of a console of running robots. For the event loop's thread."""

    def __init__(self, hub: Hub) -> None:
        self._hub = hub
        self._leases = OperatorLeases()
        self._names: dict[int, str] = {}  # of operators, by the number of the connection
        self._limits: dict[str, dict[str, float] | None] = {}  # of speed, by robot
        self._drivers: dict[str, Driver] = {}  # the last one of each robot
        self._clients: dict[str, Robot] = {}  # by robot, of one connection
        self._connection: Connection | None = None
        self._workers = ThreadPoolExecutor(_WORKERS, "cairn call")
        # An emergency stop does not wait until other calls have ended.
        self._stop_workers = ThreadPoolExecutor(_STOP_WORKERS, "cairn stop")
        self._turns: defaultdict[int, asyncio.Semaphore] = defaultdict(
            lambda: asyncio.Semaphore(_MOST_AT_ONCE)
        )
        self._state = StateEvents(hub, lambda _: time.monotonic_ns())
        self._processes = ProcessMonitor()
        self._checked: Connection | None = None  # whether its user may steer
        self._sent: dict[tuple[int, str], dict[str, Any]] = {}  # lease, by browser and robot
        self.methods: Mapping[str, ConsoleMethod] = {
            "acquire_lease": ConsoleMethod(LeaseRequest, self._acquire_lease, is_service=True),
            "release_lease": ConsoleMethod(OfRobot, self._release_lease, is_service=True),
            "ask_lease": ConsoleMethod(LeaseRequest, self._ask_lease, is_service=True),
            "answer_lease": ConsoleMethod(LeaseAnswer, self._answer_lease, is_service=True),
            "go": ConsoleMethod(GoRequest, self._go, is_service=True),
            "cancel": ConsoleMethod(OfRobot, self._cancel, is_service=True),
            "locate": ConsoleMethod(LocateRequest, self._locate, is_service=True),
            "stop": ConsoleMethod(StopRequest, self._stop, is_service=True),
            "release_stop": ConsoleMethod(OfRobot, self._release_stop, is_service=True),
            "drive": ConsoleMethod(DriveRequest, self._drive),
            "restart": ConsoleMethod(OfComponent, self._restart, is_service=True),
            "load": ConsoleMethod(OfComponent, self._load, is_service=True),
            "unload": ConsoleMethod(OfComponent, self._unload, is_service=True),
            "parameters": ConsoleMethod(OfComponent, self._parameters, changes=False),
            "set_parameters": ConsoleMethod(ParameterChanges, self._set_parameters),
            "logs": ConsoleMethod(OfRobot, self._logs, changes=False),
            "world": ConsoleMethod(WorldRequest, self._world, changes=False, is_service=True),
            "zones": ConsoleMethod(ZonesRequest, self._zones, changes=False, is_service=True),
            "proposals": ConsoleMethod(ProposalsRequest, self._proposals, is_service=True),
            "why": ConsoleMethod(WhyRequest, self._why, changes=False, is_service=True),
        }

    # What the hub calls

    async def run(self) -> None:
        """Send the events that come at intervals, until canceled."""
        try:
            while True:
                await self._tick()
                await asyncio.sleep(_PERIOD_S)
        finally:
            for driver in self._drivers.values():
                driver.end()
            for driver in self._drivers.values():
                driver.join(1.0)
            self._workers.shutdown(wait=False, cancel_futures=True)
            self._stop_workers.shutdown(wait=False, cancel_futures=True)

    def connected(self, browser: Browser) -> None:
        """Send a new browser what it does not get otherwise."""
        if browser.is_console:
            self._state.send_last(browser)
            for robot in self._hub.robots:
                self._send_lease(browser, robot)

    def disconnected(self, browser: Browser) -> None:
        """Stop the robots that a browser drives, and end its leases."""
        concerned = self._leases.leave(browser.id)
        self._names.pop(browser.id, None)
        self._turns.pop(browser.id, None)
        for key in [key for key in self._sent if key[0] == browser.id]:
            del self._sent[key]
        self._leases_changed(concerned)

    def refusal(self, browser: Browser, robot: str) -> str:
        """Return why a browser may not publish to a robot now; "" if it may."""
        if browser.may == "watch":
            return self._hub.why_watch
        if not robot:
            return (
                "no robot has this topic; a robot's topics begin with its name, as in /robot/scan"
            )
        try:
            self._leases.require(robot, browser.id)
        except CairnError as error:
            return str(error)
        return ""

    # The lease

    async def _acquire_lease(self, browser: Browser, to: LeaseRequest) -> Any:
        self._check_robot(to.robot)
        self._leases.acquire(to.robot, self._operator(browser, to.name))
        return await self._lease_taken(browser, to.robot)

    async def _ask_lease(self, browser: Browser, to: LeaseRequest) -> Any:
        self._check_robot(to.robot)
        if self._leases.ask(to.robot, self._operator(browser, to.name)):
            return await self._lease_taken(browser, to.robot)
        self._leases_changed([to.robot])
        return self._lease_of(browser, to.robot)

    async def _release_lease(self, browser: Browser, of: OfRobot) -> Any:
        self._leases.release(of.robot, browser.id)
        self._leases_changed([of.robot])
        return self._lease_of(browser, of.robot)

    async def _answer_lease(self, browser: Browser, answer: LeaseAnswer) -> Any:
        self._leases.answer(answer.robot, browser.id, grant=answer.grant)
        self._leases_changed([answer.robot])
        return self._lease_of(browser, answer.robot)

    async def _lease_taken(self, browser: Browser, robot: str) -> Any:
        self._leases_changed([robot])
        if self._limits.get(robot) is None:
            self._limits[robot] = await self._speed_limits(browser, robot)
        self._leases_changed([robot])
        return self._lease_of(browser, robot)

    async def _speed_limits(self, browser: Browser, robot: str) -> dict[str, float] | None:
        """Return the limits of the velocity gate; None without a gate: nothing can be driven."""
        for _ in range(_GATE_ATTEMPTS):
            with suppress(CairnError):
                return await self._call(browser, robot, lambda client: _gate_limits(client, robot))
        return None

    def _operator(self, browser: Browser, name: str | None) -> Operator:
        if name is not None and name.strip():
            self._names[browser.id] = name.strip()
        default = f"{'browser' if browser.is_console else 'Foxglove client'} {browser.id}"
        return Operator(browser.id, self._names.get(browser.id, default))

    def _lease_of(self, browser: Browser, robot: str) -> dict[str, Any]:
        return {**self._leases.state(robot, browser.id), "limits": self._limits.get(robot)}

    def _leases_changed(self, robots: list[str]) -> None:
        """Stop driving without a lease, and send the browsers what has changed."""
        for robot in robots:
            holder = dict(self._leases.held()).get(robot)
            driver = self._drivers.get(robot)
            if driver is not None and driver.operator_id != holder:
                driver.end()
            for browser in self._hub.browsers:
                self._send_lease(browser, robot)

    def _send_lease(self, browser: Browser, robot: str) -> None:
        state = self._lease_of(browser, robot)
        if browser.is_console and self._sent.get((browser.id, robot)) != state:
            self._sent[browser.id, robot] = state
            self._hub.send_event(browser, "lease", state, key=f"lease {robot}")

    # Driving

    async def _drive(self, browser: Browser, command: DriveRequest) -> Any:
        robot = command.robot
        self._leases.require(robot, browser.id)
        driver = self._drivers.get(robot)
        if driver is None or driver.is_over or driver.operator_id != browser.id:
            driver = self._new_driver(browser, robot)
        stamp = driver.command(command.stamp, (command.speed, command.turn))
        if not driver.is_ready:
            wait = driver.wait
            await self._call(browser, robot, lambda _: wait(_GATE_LIMIT_S))
            stamp = driver.command(None, STILL)
        return {"stamp": stamp, "limits": self._limits.get(robot)}

    def _new_driver(self, browser: Browser, robot: str) -> Driver:
        client, operator = self._client(robot), f"{self._operator(browser, None).name} (console)"
        before = self._drivers.get(robot)
        if before is not None:
            before.end()
        driver = Driver(browser.id, lambda: client.teleoperation(operator), before)
        self._drivers[robot] = driver
        return driver

    def _stop_driving(self, robot: str) -> None:
        """Leave the robot to its navigator."""
        if (driver := self._drivers.get(robot)) is not None:
            driver.end()

    # Steering

    async def _go(self, browser: Browser, to: GoRequest) -> Any:
        self._leases.require(to.robot, browser.id)
        self._stop_driving(to.robot)

        def send(robot: Robot) -> dict[str, str]:
            with robot.go_through(to.poses) as goal:
                return {"goal_id": goal.id}

        return await self._steer(browser, to.robot, send)

    async def _cancel(self, browser: Browser, of: OfRobot) -> Any:
        return await self._steer(browser, of.robot, lambda robot: {"goal_id": robot.cancel()})

    async def _locate(self, browser: Browser, at: LocateRequest) -> Any:
        message = _pose_message(at)
        await self._steer(browser, at.robot, lambda robot: robot.publish(_POSE_TOPIC, message))

    async def _stop(self, browser: Browser, of: StopRequest) -> Any:
        self._stop_driving(of.robot)
        operator = self._operator(browser, None).name
        reason = of.reason.strip() or "requested"
        text = f"{reason} (console, {operator})"
        client = self._client(of.robot)
        status = await _run(self._stop_workers, lambda: client.stop(text))
        return {"emergency_stop": status.emergency_stop, "reason": status.reason}

    async def _release_stop(self, browser: Browser, of: OfRobot) -> Any:
        status = await self._steer(browser, of.robot, lambda robot: robot.release_stop())
        return {"emergency_stop": status.emergency_stop, "reason": status.reason}

    # Components

    async def _restart(self, browser: Browser, of: OfComponent) -> Any:
        return await self._steer(browser, of.robot, lambda robot: robot.restart(of.component))

    async def _load(self, browser: Browser, of: OfComponent) -> Any:
        return await self._steer(browser, of.robot, lambda robot: robot.load(of.component))

    async def _unload(self, browser: Browser, of: OfComponent) -> Any:
        return await self._steer(browser, of.robot, lambda robot: robot.unload(of.component))

    async def _parameters(self, browser: Browser, of: OfComponent) -> Any:
        return await self._call(
            browser,
            of.robot,
            lambda robot: [vars(one) for one in robot.parameters(of.component).values()],
        )

    async def _set_parameters(self, browser: Browser, to: ParameterChanges) -> Any:
        await self._steer(
            browser, to.robot, lambda robot: robot.set_parameters(to.component, to.values)
        )
        self._hub.parameters_changed(to.robot, to.component, to.values)

    async def _logs(self, browser: Browser, of: OfRobot) -> Any:
        return await self._call(
            browser, of.robot, lambda robot: [to_plain(entry, None) for entry in robot.logs()]
        )

    # Requests to the component of a plugin

    async def _world(self, browser: Browser, of: WorldRequest) -> Any:
        if of.verb != "list":
            self._check_may_publish(browser, of.robot)
        return await self._call(browser, of.robot, _of_plugin(_WORLD, of.verb, of.arguments))

    async def _why(self, browser: Browser, of: WhyRequest) -> Any:
        arguments = {"object": str(of.object_id), "last": of.last}
        return await self._call(browser, of.robot, _of_plugin(_MAP_BUILDER, "why", arguments))

    async def _zones(self, browser: Browser, of: ZonesRequest) -> Any:
        ask = _of_plugin(_MAP_BUILDER, of.verb, of.arguments)
        if of.verb == "zones":
            return await self._call(browser, of.robot, ask)
        self._check_may_publish(browser, of.robot)
        return await self._steer(browser, of.robot, ask)

    async def _proposals(self, browser: Browser, of: ProposalsRequest) -> Any:
        ask = _of_plugin(_OBJECT_FINDER, of.verb, of.arguments)
        return await self._steer(browser, of.robot, ask)

    def _check_may_publish(self, browser: Browser, robot: str) -> None:
        if reason := self.refusal(browser, robot):
            raise CairnError(reason)

    # Calls of the robot, which block

    def _check_robot(self, robot: str) -> None:
        robots = self._hub.robots
        if robot not in robots:
            raise CairnError(f"there is no robot {robot}; there are: {', '.join(robots) or 'none'}")

    def _client(self, robot: str) -> Robot:
        """Return the client of a robot; `CairnError` if there is no such robot now."""
        connection = self._hub.source.connection
        self._check_robot(robot)
        if connection is not self._connection:
            self._connection = connection
            self._clients.clear()
        if robot not in self._clients:
            loop = asyncio.get_running_loop()

            def notify(text: str) -> None:
                loop.call_soon_threadsafe(self._notify, text)

            self._clients[robot] = Robot(connection, robot, notify)
        return self._clients[robot]

    def _notify(self, text: str) -> None:
        for browser in self._hub.browsers:
            browser.send_status(WARNING, text)

    async def _steer(self, browser: Browser, robot: str, call: Callable[[Robot], R]) -> R:
        """Make a call of the browser that has the lease, now and when it is the call's turn."""
        check = functools.partial(self._leases.require, robot, browser.id)
        check()
        return await self._call(browser, robot, call, check)

    async def _call(
        self,
        browser: Browser,
        robot: str,
        call: Callable[[Robot], R],
        check: Callable[[], None] = lambda: None,
    ) -> R:
        client = self._client(robot)
        async with self._turns[browser.id]:
            check()
            return await _run(self._workers, functools.partial(call, client))

    # Events

    async def _tick(self) -> None:
        """Send what has changed within the last second."""
        self._leases_changed(self._leases.expire())
        for robot in self._hub.robots:
            for browser in self._hub.browsers:
                self._send_lease(browser, robot)
        connection = self._connection_now()
        pids = self._state.update(connection.router_process() if connection is not None else None)
        loads = await asyncio.to_thread(self._processes.loads, pids) if pids else {}
        self._state.send(loads, time.monotonic_ns())
        await self._check_role()

    async def _check_role(self) -> None:
        """Let browsers only watch if the console's user on the network may not steer."""
        robots = self._hub.robots
        if self._hub.may == "watch" or not robots or self._checked is self._connection_now():
            return
        client = self._client(robots[0])
        self._checked = client.connection
        if not await _run(self._workers, functools.partial(may_operate, client, robots[0])):
            self._hub.restrict(_VIEW_ONLY)

    def _connection_now(self) -> Connection | None:
        try:
            return self._hub.source.connection
        except CairnError:
            return None


async def _run(workers: ThreadPoolExecutor, call: Callable[[], R]) -> R:
    return await asyncio.get_running_loop().run_in_executor(workers, call)


def may_operate(client: Robot, robot: str) -> bool:
    """Return whether this client may steer a robot, as far as that can be known.

    It asks the velocity gate for what the role view allows, then for what the gate always rejects
    and needs the role operate: over the network, a role that may not is not even answered.
    """
    connection = client.connection
    for full, status in connection.statuses().items():
        if not full.startswith(f"/{robot}/") or status.plugin != _VELOCITY_GATE:
            continue
        with suppress(CairnError):
            connection.request(full, "status", timeout_s=_PROBE_S)
            try:
                no_lease = {"lease": 0, "seconds": 1.0}
                connection.request(full, "renew_lease", no_lease, timeout_s=_PROBE_S)
            except NoReplyError:
                return False
            except ControlError:
                return True
    return True


def _of_plugin(plugin: str, verb: str, arguments: Mapping[str, Any]) -> Callable[[Robot], Any]:
    """Return the function that makes a request to a robot's component of a plugin."""
    return lambda robot: robot.request_plugin(
        plugin, verb, arguments, missing=_MISSING[plugin], timeout_s=_REPLY_LIMIT_S
    )


def _gate_limits(client: Robot, robot: str) -> dict[str, float]:
    """Return the limits of the velocity gate [m/s, rad/s]."""
    parameters = client.parameters(find_gate(client, robot).name)
    return {
        name: float(parameters[name].value)
        for name in ("speed", "reverse_speed", "turn_speed")
        if name in parameters
    }


def _pose_message(at: LocateRequest) -> PoseWithCovarianceStamped:
    half = at.theta / 2.0
    pose = Pose(
        position=Point(x=at.x, y=at.y),
        orientation=Quaternion(z=math.sin(half), w=math.cos(half)),
    )
    return PoseWithCovarianceStamped(
        header=Header(frame_id="map"), pose=PoseWithCovariance(pose=pose)
    )

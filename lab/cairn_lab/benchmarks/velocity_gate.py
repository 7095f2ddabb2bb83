"""Velocity gate: collisions under hostile commands, time from a scan to the stop, added latency.

Collisions are counted in lockstep: a simulated robot in a hall, obstacles put before it while it
moves, and forged, late or contradictory commands. The other figures need real processes.
"""

from __future__ import annotations

import json
import logging
import math
import statistics
import tempfile
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import yaml
from numpy.typing import NDArray

from cairn import In, Out, every, on
from cairn.bus.bus import Subscription
from cairn.bus.exclusive import Exclusive
from cairn.bus.qos import SENSOR
from cairn.components.simulation.base import SimulatedBaseConfig
from cairn.components.velocity_gate.collision_monitor import allowed_share
from cairn.components.velocity_gate.config import VelocityGateConfig
from cairn.errors import CairnError
from cairn.planar.messages import planar_pose, pose_message
from cairn.planar.poses import Pose, compose
from cairn.runtime.component import Component
from cairn.schemas.builtin_interfaces import from_ns, to_ns
from cairn.schemas.cairn_nav_msgs import Collision, TeleoperationCommand
from cairn.schemas.cairn_sim_msgs import WorldState
from cairn.schemas.geometry_msgs import PoseWithCovariance, Twist, TwistWithCovariance, Vector3
from cairn.schemas.nav_msgs import Odometry
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import Header
from cairn.system.clock import SECOND
from cairn.testing.lockstep import DeploymentHarness
from cairn_lab.benchmarks.result import Metric
from cairn_lab.benchmarks.running import results, run_deployment

Kind = Literal["forged", "late", "contradictory"]
KINDS: tuple[Kind, ...] = get_args(Kind)
RUNS = 200
STOP_TRIALS = 100
_RUN_S = 15.0
_STANDS_S, _FREE_S = (1.0, 3.0), (0.2, 2.0)  # ranges of times with and without an obstacle
_TICK_S = 0.02
_SCAN_S, _SWEEP_S = 0.1, 0.019  # period and duration of a scan
_STOP_LIMIT_MS = 1e3 * _SCAN_S + 20.0
_RADIUS = 0.22
ROUNDS = 3
_LOGGED = 100  # values in a line of the log
# Commands to measure [1], their least speed [m/s], the difference of two [m/s], and how many
# different ones there are [1].
_COMMANDS, _SPEED, _CODED, _CODES = 1200, 0.5, 1e-4, 100
_HERE = "cairn_lab.benchmarks.velocity_gate"
_GATE = "components.velocity_gate.parameters"
_NOISE_M = 0.03  # two standard deviations of a simulated range
_HALL_M = 14.0
_BOX, _FORGED = "box", "forged"  # name of the obstacle; frame of forged scans
# A lower command [m/s]; the noise of ranges lets a robot that stands before a box creep [m/s].
_LOWER, _CREEPS = 1e-3, 0.06


class Navigator(Component):
    """The entitled writer of the navigator's commands; the benchmark publishes by its port."""

    cmd_vel: Out[Twist] = Out(qos=SENSOR)


class GatedRobot(DeploymentHarness):
    """A simulated robot in a hall, behind the gate, in lockstep; the benchmark is its sources.

    `commands` are the gate's commands to the base with their times [ns], `states` the robot's true
    states.
    """

    def __init__(self, folder: Path, seed: int, *sets: str) -> None:
        super().__init__(_deployment(folder), sets=sets, seed=seed)
        self.states = self.read("world_state", WorldState).messages
        self.collisions = self.read("collisions", Collision).messages
        self.scans = self.read("scan", LaserScan).messages
        self.commands: list[tuple[int, float, float]] = []
        self._gate: Subscription | None = None
        self._gate = self.bus.node("/robot/reader", _ignore).subscribe(
            "/robot/cmd_vel", Twist, SENSOR, self._note, Exclusive("/robot/velocity_gate")
        )
        other = self.bus.node("/robot/world", _ignore)
        self._forged = {
            topic: other.advertise(f"/robot/{topic}", Twist, SENSOR)
            for topic in ("cmd_vel", "navigator_cmd_vel")
        }
        self._forged_scans = other.advertise("/robot/scan", LaserScan, SENSOR)
        self.boxes: list[tuple[Pose, float]] = []

    @property
    def pose(self) -> Pose:
        """The true pose."""
        return planar_pose(self.states[-1].robot)

    @property
    def refused(self) -> int:
        """Number of forged messages that reached this run's reading of `cmd_vel`."""
        return 0 if self._gate is None else self._gate.refused

    def navigate(self, speed: float, turn: float) -> None:
        """Publish a command of the navigator."""
        navigator = self.run.runtime("navigator").component
        assert isinstance(navigator, Navigator)
        navigator.cmd_vel.publish(_twist(speed, turn))

    def external(self, speed: float, turn: float) -> None:
        """Publish a command of another program."""
        self.publish("external_cmd_vel", _twist(speed, turn), qos=SENSOR, handled=False)

    def teleoperate(self, lease: int, speed: float, turn: float, age_s: float = 0.0) -> None:
        """Publish a command of an operator, stamped `age_s` [s] ago."""
        stamp = from_ns(max(0, self.now_ns - round(age_s * SECOND)))
        command = TeleoperationCommand(
            header=Header(stamp=stamp), lease=lease, twist=_twist(speed, turn)
        )
        self.publish("teleoperation", command, qos=SENSOR, handled=False)

    def forge(self, speed: float, turn: float) -> None:
        """Publish a command to base and gate, as a program outside and as another component.

        Also publish a scan without obstacles.
        """
        for topic, publisher in self._forged.items():
            self.publish(topic, _twist(speed, turn), qos=SENSOR, handled=False)
            publisher.publish(_twist(speed, turn))
        self._forged_scans.publish(_scan(self.now_ns, np.full(361, 5.0, np.float32), _FORGED))

    def put_obstacle(self, gap: float, aside: float, random: np.random.Generator) -> bool:
        """Put a box `gap` [m] before the robot, in a straight line; return whether there was room.

        It is up to `aside` [rad] to the left or right.
        """
        size = float(random.uniform(0.05, 0.5))
        x, y, theta = self.pose
        bearing = theta + float(random.uniform(-aside, aside))
        apart = _RADIUS + gap + size / 2.0
        box = (x + apart * math.cos(bearing), y + apart * math.sin(bearing), bearing)
        place = {"x": box[0], "y": box[1], "theta": box[2], "size": [size, size]}
        try:
            self.request("world", "furniture", name=_BOX, **place)
        except CairnError:
            return False
        self.boxes = [(box, size)]
        return True

    def remove_obstacle(self) -> None:
        """Remove the box."""
        self.request("world", "remove", name=_BOX)
        self.boxes = []

    def stopping_gap(self) -> float:
        """Return the way [m] on which the base can stop for something that appears now.

        The next complete scan shows it; until the base reacts to that, the robot may accelerate.
        """
        base = SimulatedBaseConfig()
        base = SimulatedBaseConfig()
        react_s = self.next_scan_s() + _SWEEP_S + base.lag_s + 2.0 * _TICK_S
        speed = abs(self.states[-1].forward)
        fastest = min(base.speed, speed + base.acceleration * react_s)
        return fastest * react_s + fastest**2 / (2.0 * base.acceleration) + _NOISE_M

    def next_scan_s(self) -> float:
        """Return the time [s] until the next scan begins."""
        true = next(one for one in reversed(self.scans) if one.header.frame_id != _FORGED)
        return (to_ns(true.header.stamp) / SECOND - self.now) % _SCAN_S

    def _note(self) -> None:
        if self._gate is not None:
            while (command := self._gate.take()) is not None:
                self.commands.append((self.now_ns, command.linear.x, command.angular.z))


@dataclass(frozen=True)
class RunResult:
    """The outcome of one run: contacts, obstacles put, true way [m], forged messages."""

    collisions: int
    obstacles: int
    way_m: float
    forged: int


def hostile_run(
    folder: Path, kind: Kind, seed: int, seconds: float = _RUN_S, *sets: str
) -> RunResult:
    """Drive for some seconds with hostile commands of one kind, and put obstacles in the way.

    `sets` change the deployment as for `cairn up --set`.
    """
    random = np.random.default_rng([seed, KINDS.index(kind)])
    external = f"{_GATE}.external.enabled={str(kind != 'forged').lower()}"
    with GatedRobot(folder, seed, external, *sets) as robot:
        robot.run_for(0.5)
        sources = _SOURCES[kind](robot, random)
        next_s, put = robot.now + 1.5, 0
        while robot.now < seconds:
            next(sources)
            robot.run_for(_TICK_S)
            if robot.now >= next_s and robot.boxes:
                robot.remove_obstacle()
                next_s = robot.now + float(random.uniform(*_FREE_S))
            elif robot.now >= next_s and robot.states[-1].forward > 0.1:
                gap = robot.stopping_gap() + float(random.choice([0.0, random.uniform(0.0, 1.0)]))
                put += robot.put_obstacle(gap, 0.25, random)
                next_s = robot.now + float(random.uniform(*_STANDS_S))
        way = sum(
            math.dist((a.robot.position.x, a.robot.position.y),
                      (b.robot.position.x, b.robot.position.y))
            for a, b in zip(robot.states, robot.states[1:], strict=False)
        )  # fmt: skip
        return RunResult(len(robot.collisions), put, way, robot.refused)


def _style(random: np.random.Generator, least: float) -> tuple[float, float]:
    """Return a speed of at least `least` [m/s] and a turn rate, sometimes beyond all limits."""
    match random.integers(6):
        case 0:
            return 1e300, 0.0
        case 1:
            return max(least, -1e300), float(random.uniform(-1e3, 1e3))
        case 2:
            return float(random.uniform(0.3, 0.6)), 0.0
        case _:
            return float(random.uniform(least, 0.9)), float(random.uniform(-2.0, 2.0))


def _ahead(random: np.random.Generator) -> tuple[float, float]:
    return float(random.uniform(0.3, 0.7)), float(random.uniform(-0.6, 0.6))


def _forged(robot: GatedRobot, random: np.random.Generator) -> Iterator[None]:
    """The navigator drives; others forge commands to base and gate, and an operator's lease."""
    honest, forged = _ahead(random), _style(random, -0.6)
    while True:
        if random.random() < 0.03:
            honest = _ahead(random)
        if random.random() < 0.1:
            forged = _style(random, -0.6)
        robot.navigate(*honest)
        robot.forge(*forged)
        robot.external(*forged)
        robot.teleoperate(int(random.integers(1, 2**62)), *forged)
        yield


def _late(robot: GatedRobot, random: np.random.Generator) -> Iterator[None]:
    """All sources' commands arrive 0.31 to 2 s late, some in bursts; stamps are also ahead."""
    pending: list[tuple[float, int, tuple[float, float]]] = []
    delays = [float(random.uniform(0.31, 2.0)) for _ in range(3)]
    commands = [_ahead(random), _style(random, -0.6), _style(random, 0.0)]
    lease = 0
    while True:
        if random.random() < 0.03:
            number = int(random.integers(3))
            delays[number] = float(random.uniform(0.31, 2.0))
            commands[number] = _ahead(random) if number == 0 else _style(random, 0.0)
        if random.random() < 0.005:
            lease = _acquire(robot)
        bursts = random.random() < 0.7
        pending += [(robot.now + delays[one], one, commands[one]) for one in range(3)]
        for item in [one for one in pending if bursts and one[0] <= robot.now]:
            pending.remove(item)
            _, number, command = item
            if number == 0:
                robot.navigate(*command)
            elif number == 1 and random.random() < 0.2:
                robot.external(*command)
            elif number == 2:
                age = delays[2] * float(random.choice([-1.0, 0.0, 1.0]))
                robot.teleoperate(lease, *command, age)
        yield


def _contradictory(robot: GatedRobot, random: np.random.Generator) -> Iterator[None]:
    """Navigator, operator and another program command different things at once."""
    commands = [_ahead(random), _style(random, -0.6), _style(random, 0.0)]
    silent = [False, False, True]
    alternates, lease, sign = False, 0, 1.0
    while True:
        if random.random() < 0.1:
            number = int(random.integers(3))
            commands[number] = _style(random, 0.0 if number == 2 else -0.6)
            if random.random() < 0.5:
                commands[number] = _ahead(random)
            silent[number] = bool(random.random() < (0.3, 0.7, 0.5)[number])
            alternates = bool(random.random() < 0.15)
        if random.random() < 0.01:
            lease = _acquire(robot)
        if lease and random.random() < 0.01:
            _release(robot, lease)
        sign = -sign if alternates else 1.0
        if not silent[0]:
            robot.navigate(sign * commands[0][0], commands[0][1])
        if not silent[1]:
            robot.external(commands[1][0], sign * commands[1][1])
        if not silent[2]:
            robot.teleoperate(lease, commands[2][0], sign * commands[2][1])
        yield


_SOURCES = {"forged": _forged, "late": _late, "contradictory": _contradictory}


def _acquire(robot: GatedRobot) -> int:
    answer = robot.request("velocity_gate", "take_over_lease", operator="anna", seconds=1.5)
    return int(answer["lease"])


def _release(robot: GatedRobot, lease: int) -> None:
    try:
        robot.request("velocity_gate", "release_lease", lease=lease)
    except CairnError:  # it is over
        return


@dataclass(frozen=True)
class StopTimes:
    """Times [ms] until the gate brakes: from the obstacle's appearance, and from the first scan.

    `gap_m` is the distance that the robot kept [m].
    """

    from_appearance: float
    from_scan: float
    gap_m: float


def stop_times(folder: Path, seed: int) -> StopTimes | None:
    """Return when the gate brakes for a box that appears within the stop zone of the robot.

    None if, when the first scan sees it, the robot need not brake yet.
    """
    random = np.random.default_rng(seed)
    speed = float(random.uniform(0.25, 0.6))
    with GatedRobot(folder, seed) as robot:
        robot.run_for(0.5)
        for _ in range(round(float(random.uniform(2.0, 2.5)) / _TICK_S)):
            robot.navigate(speed, 0.0)
            robot.run_for(_TICK_S)
        robot.run_for(float(random.uniform(0.0, _TICK_S)))
        appeared = robot.now_ns
        # At the first scan the box is at 92 to 100 % of the stopping way: the base can stop there.
        zone = _stopping_way(robot.states[-1].forward)
        gap = robot.next_scan_s() * robot.states[-1].forward + zone * random.uniform(0.92, 1.0)
        if not robot.put_obstacle(float(gap), 0.05, random):
            return None
        while robot.now_ns < appeared + 4 * SECOND:
            robot.navigate(speed, 0.0)
            robot.run_for(_TICK_S)
        stamps = [to_ns(scan.header.stamp) for scan in robot.scans]
        first = next(one for one in stamps if one + _SWEEP_S * SECOND >= appeared)
        state = min(robot.states, key=lambda one: abs(to_ns(one.header.stamp) - first))
        if not _in_stop_zone(state, robot.boxes[0]):
            return None
        after = [command for command in robot.commands if command[0] >= appeared]
        stopped = next(at for at, now, _ in after if now < speed - _LOWER)
        assert not robot.collisions, f"seed {seed}: collision"
        assert max(now for _, now, _ in after[-20:]) < _CREEPS, f"seed {seed}: still driving"
        end = planar_pose(robot.states[-1].robot)
        outline = _points(robot.boxes[0], end)
        return StopTimes(
            (stopped - appeared) / 1e6,
            (stopped - first) / 1e6,
            float(np.hypot(outline[:, 0], outline[:, 1]).min()) - _RADIUS,
        )


class SensorsAndNavigator(Component):
    """A robot's sensors and its navigator: odometry, scans, and commands with a value of their own.

    Every other command goes to the gate, the others directly to the reader. From time to time the
    scans show an obstacle.
    """

    odom: Out[Odometry] = Out(qos=SENSOR)
    scan: Out[LaserScan] = Out(qos=SENSOR)
    navigator_cmd_vel: Out[Twist] = Out(qos=SENSOR)
    direct_cmd_vel: Out[Twist] = Out(qos=SENSOR)

    def on_activate(self) -> None:
        """Start with the first command."""
        self._sent: list[tuple[int, int]] = []
        self._shown: list[int] = []
        self._pose: Pose = (0.0, 0.0, 0.0)
        self._number = self._scans = 0
        self._command()

    @every(hz=50)
    def publish_odometry(self) -> None:
        """Publish the odometry of a robot that drives straight ahead."""
        self._pose = compose(self._pose, (_SPEED * 0.02, 0.0, 0.0))
        self.odom.publish(
            Odometry(
                header=Header(stamp=from_ns(self.clock.now()), frame_id="odom"),
                child_frame_id="base_link",
                pose=PoseWithCovariance(pose=pose_message(self._pose)),
                twist=TwistWithCovariance(twist=_twist(_SPEED, 0.0)),
            )
        )

    @every(hz=10)
    def publish_scan(self) -> None:
        """Publish a scan; a wall is 5 m away, and every 2 s, for 0.3 s, a box is near."""
        self._scans += 1
        ranges = np.full(361, 5.0, np.float32)
        if self._scans % 20 in (17, 18, 19):
            ranges[175:186] = 0.35
        stamp = self.clock.now() - round(_SWEEP_S * SECOND)
        if self._scans % 20 == 17:
            self._shown.append(stamp)
        self.scan.publish(_scan(stamp, ranges, "laser"))

    def _command(self) -> None:
        number, self._number = self._number, self._number + 1
        port = self.navigator_cmd_vel if number % 2 else self.direct_cmd_vel
        value = _SPEED + _CODED * (number % _CODES)
        self._sent.append((number, self.clock.now()))
        port.publish(_twist(value, 0.0))
        if number < _COMMANDS:
            pause_s = float(self.random.uniform(0.015, 0.025))
            self.schedule(self.clock.now() + round(pause_s * SECOND), self._command)
        else:
            _log(self, "sent", self._sent)
            _log(self, "shown", self._shown)
            self.finish("measured")


class BaseReader(Component):
    """Notes when commands arrive, from the gate and directly."""

    cmd_vel: In[Twist] = In(qos=SENSOR, exclusive=True)
    direct_cmd_vel: In[Twist] = In(qos=SENSOR)

    def on_activate(self) -> None:
        """Start without commands."""
        self._arrived: list[tuple[int, float, bool]] = []

    @on("cmd_vel")
    def on_cmd_vel(self, command: Twist) -> None:
        """Note a command of the gate."""
        self._arrived.append((self.clock.now(), command.linear.x, True))

    @on("direct_cmd_vel")
    def on_direct_cmd_vel(self, command: Twist) -> None:
        """Note a command that did not pass the gate."""
        self._arrived.append((self.clock.now(), command.linear.x, False))

    def on_deactivate(self) -> None:
        """Log what arrived."""
        _log(self, "arrived", self._arrived)


def _log(component: Component, name: str, values: Sequence[Any]) -> None:
    """Log the values of a result, in lines short enough for the log."""
    for first in range(0, len(values), _LOGGED):
        part = list(values[first : first + _LOGGED])
        component.log.info("RESULT %s", json.dumps({name: part}))


@dataclass(frozen=True)
class RealTimes:
    """Times [ms] in real processes, of all commands and of all obstacles.

    `direct`, `gated`: from a command's publication to its arrival, directly and by the gate.
    `stops`: from the stamp of the first scan with an obstacle to the first lower command's arrival.
    """

    direct: list[float]
    gated: list[float]
    stops: list[float]


def real_times() -> RealTimes:
    """Measure the gate between two processes, linked by Unix sockets."""
    output = run_deployment(
        {
            "reader": {"plugin": f"{_HERE}:{BaseReader.__name__}"},
            "velocity_gate": {"plugin": "velocity_gate"},
            "robot": {
                "plugin": f"{_HERE}:{SensorsAndNavigator.__name__}",
                "restart": "transient",
                "significant": True,
            },
        },
        120,
    )
    found = defaultdict[str, list[Any]](list)
    for result in results(output):
        for name, values in result.items():
            found[name] += values
    direct: list[float] = []
    gated: list[float] = []
    waiting = dict(found["sent"])
    for at, value, by_gate in found["arrived"]:
        # The ramp of the gate may reach a command in several steps: the first one counts.
        code = math.ceil((value - _SPEED) / _CODED - 1e-3)
        code += by_gate and code % 2 == 0
        recent = [
            one
            for one in waiting
            if one % _CODES == code and one % 2 == by_gate and 0 <= at - waiting[one] < SECOND // 5
        ]
        if recent:
            sent = waiting.pop(recent[0])
            (gated if by_gate else direct).append((at - sent) / 1e6)
    stops = [
        min(at for at, value, by_gate in found["arrived"]
            if by_gate and at > shown and value < _SPEED - _CODED) - shown
        for shown in found["shown"][1:]  # at the first one, the robot has just started
    ]  # fmt: skip
    return RealTimes(direct, gated, [one / 1e6 for one in stops])


def measure() -> list[Metric]:
    """Measure collisions in 200 runs, times to the stop, and the latency that the gate adds."""
    # Without a handler, Python prints warnings: here thousands of refusals.
    logging.getLogger("cairn").addHandler(logging.NullHandler())
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        runs = [hostile_run(folder, KINDS[seed % len(KINDS)], seed) for seed in range(RUNS)]
        trials = [stop_times(folder, seed) for seed in range(STOP_TRIALS)]
    stops = [trial for trial in trials if trial is not None]
    rounds = [real_times() for _ in range(ROUNDS)]
    added = [statistics.median(one.gated) - statistics.median(one.direct) for one in rounds]
    direct = statistics.median(statistics.median(one.direct) for one in rounds)
    gated = statistics.median(statistics.median(one.gated) for one in rounds)
    real_stops = sorted(stop for one in rounds for stop in one.stops)
    appearance = sorted(one.from_appearance for one in stops)
    return [
        Metric(
            f"{RUNS} runs of forged, late, contradictory commands: collisions",
            float(sum(run.collisions for run in runs)),
            "",
            at_most=0,
            note=f"{sum(run.obstacles for run in runs)} obstacles, "
            f"{sum(run.way_m for run in runs):.0f} m, {sum(run.forged for run in runs)} forged",
        ),
        Metric(
            "first scan with the obstacle to the gate's first lower command: longest",
            max(one.from_scan for one in stops),
            "ms",
            at_most=_STOP_LIMIT_MS,
            note=f"lockstep, {len(stops)} obstacles; least gap {min(s.gap_m for s in stops):.3f} m",
        ),
        Metric(
            "appearance of the obstacle to the gate's first lower command: longest",
            appearance[-1],
            "ms",
            at_most=_STOP_LIMIT_MS,
            note=f"lockstep, median {statistics.median(appearance):.0f} ms",
        ),
        Metric(
            "real processes: stamp of the scan to the arrival of the first lower command: longest",
            real_stops[-1],
            "ms",
            at_most=_STOP_LIMIT_MS,
            note=f"median {statistics.median(real_stops):.1f} ms of {len(real_stops)}",
        ),
        Metric(
            "real processes: latency that the gate adds to a command, median",
            statistics.median(added),
            "ms",
            at_most=1.0,
            note=f"{gated:.2f} ms instead of {direct:.2f} ms; rounds: "
            + ", ".join(f"{one:.2f}" for one in added),
        ),
    ]


def _in_stop_zone(state: WorldState, box: tuple[Pose, float]) -> bool:
    """Return whether the gate must brake at once when a scan begins in this true state."""
    config = VelocityGateConfig()
    zone = config.outline().inflated(config.stop_margin)
    velocity = state.forward, state.turn
    contact_s = zone.seconds_to_contact(_points(box, planar_pose(state.robot)), velocity)
    reaction_s = config.latency + _SWEEP_S
    return allowed_share(
        contact_s, velocity, config.stopping_ability(), reaction_s, turns=False
    ) < 1.0  # fmt: skip


def _stopping_way(speed: float) -> float:
    """Return the way [m] on which the gate lets a robot stop after a scan began."""
    config = VelocityGateConfig()
    reaction_s = config.latency + _SWEEP_S
    return config.stop_margin + speed * reaction_s + speed**2 / (2.0 * config.braking)


def _points(box: tuple[Pose, float], robot: Pose) -> NDArray[np.float64]:
    """Return points (n, 2) [m] of a box's outline in the frame of the robot."""
    (bx, by, bt), size = box
    along = np.linspace(-size / 2.0, size / 2.0, 50)
    half = np.full(50, size / 2.0)
    x = np.concatenate((along, along, half, -half))
    y = np.concatenate((half, -half, along, along))
    world = (
        np.column_stack(
            (bx + x * math.cos(bt) - y * math.sin(bt), by + x * math.sin(bt) + y * math.cos(bt))
        )
        - robot[:2]
    )
    cosine, sine = math.cos(robot[2]), math.sin(robot[2])
    return np.column_stack(
        (cosine * world[:, 0] + sine * world[:, 1], cosine * world[:, 1] - sine * world[:, 0])
    )


def _ignore(_: str) -> None:
    """Ignore the report of a refused message."""


def _twist(speed: float, turn: float) -> Twist:
    return Twist(linear=Vector3(x=speed), angular=Vector3(z=turn))


def _scan(stamp: int, ranges: NDArray[np.float32], frame: str) -> LaserScan:
    """Return a scan of 361 beams over 270 degrees."""
    step = math.radians(0.75)
    return LaserScan(
        header=Header(stamp=from_ns(stamp), frame_id=frame),
        angle_min=-180 * step,
        angle_max=180 * step,
        angle_increment=step,
        time_increment=_SWEEP_S / 361,
        range_max=10.0,
        ranges=ranges,
    )


def _deployment(folder: Path) -> Path:
    """Write the hall and its deployment; return the deployment's file."""
    corners = [[0, 0], [_HALL_M, 0], [_HALL_M, _HALL_M], [0, _HALL_M], [0, 0]]
    pillars = [
        {"name": f"pillar_{number}", "x": x, "y": y, "size": [0.4, 0.4]}
        for number, (x, y) in enumerate(((3.0, 3.0), (3.0, 11.0), (11.0, 3.0), (11.0, 11.0)))
    ]
    world = {
        "walls": [{"points": corners}],
        "furniture": pillars,
        "robot": {"x": _HALL_M / 2, "y": _HALL_M / 2, "theta": 0.0},
    }
    (folder / "hall.yaml").write_text(yaml.safe_dump(world))
    mount = {"x": 0.1}
    components = {
        "world": {"plugin": "simulated_world", "parameters": {"world": str(folder / "hall.yaml")}},
        "base": {"plugin": "simulated_base"},
        "velocity_gate": {"plugin": "velocity_gate", "parameters": {"mount": mount}},
        "range_scanner": {
            "plugin": "simulated_scanner",
            "parameters": {"mount": mount, "rate": 10, "skip": 3},
        },
        "navigator": {
            "plugin": f"{_HERE}:{Navigator.__name__}",
            "topics": {"cmd_vel": "navigator_cmd_vel"},
        },
    }
    file = folder / "hall_deployment.yaml"
    file.write_text(yaml.safe_dump({"cairn": 1, "robot": "robot", "components": components}))
    return file

"""One robot of a running deployment, as a script or a notebook uses it."""

from __future__ import annotations

import logging
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, TypeVar, overload

from cairn.bus import keys
from cairn.bus.codec import Codec
from cairn.client.connection import (
    STATUS_TOPIC,
    Connection,
    Publishers,
    check_robot,
    resolve,
)
from cairn.client.graph import (
    Endpoint,
    NodeInfo,
    endpoint_of,
    foreign_in,
    nodes_in,
    problems_of,
    read_nodes,
)
from cairn.client.navigation import MissionClient, NavigationGoal
from cairn.client.services import RunningGoal, ServiceInfo, call_service, find_services
from cairn.client.subscription import Subscription
from cairn.client.transforms import TransformListener
from cairn.client.velocity_gate import Teleoperation, find_gate, set_emergency_stop
from cairn.errors import CairnError
from cairn.runtime.rosout import ROSOUT
from cairn.schemas.cairn_msgs import ComponentStatus
from cairn.schemas.cairn_nav_msgs import VelocityGateStatus
from cairn.schemas.message import Action, InvalidMessage, Service, type_name
from cairn.schemas.rcl_interfaces import Log
from cairn.system.closing import Closing
from cairn.tf import Buffer

M = TypeVar("M")
Request = TypeVar("Request")
Response = TypeVar("Response")
Goal = TypeVar("Goal")
Result = TypeVar("Result")
Feedback = TypeVar("Feedback")

_log = logging.getLogger("cairn.client")

_REPLY_LIMIT_S = 5.0
_START_LIMIT_S = 90.0  # longer than a component takes to stop and to start, by default


@dataclass(frozen=True)
class Topic:
    """A topic on the bus.

    Attributes:
        name: full name, `/robot/pose`.
        type_name: ROS 2 name of the message type.
        publishers: full names of the nodes that publish it.
        subscribers: full names of the nodes that subscribe to it.
        foreign: full names of those nodes that are not components of Cairn.
        problems: what keeps publishers and subscribers of this name apart: two types, or a QoS that
            does not match by the rules of ROS 2.
    """

    name: str
    type_name: str
    publishers: tuple[str, ...]
    subscribers: tuple[str, ...]
    foreign: tuple[str, ...] = ()
    problems: tuple[str, ...] = ()


@dataclass(frozen=True)
class TopicInfo:
    """The publishers and subscribers of a topic.

    Attributes:
        name: full name, `/robot/pose`.
        endpoints: its publishers, then its subscribers.
        problems: as of `Topic`.
    """

    name: str
    endpoints: tuple[Endpoint, ...]
    problems: tuple[str, ...]


@dataclass(frozen=True)
class Parameter:
    """A parameter of a component.

    Attributes:
        name: dotted name.
        value: as JSON has it.
        type: its type, as Python writes it.
        bounds: what values are allowed; empty if all of the type are.
        description: what it means, with its unit.
    """

    name: str
    value: Any
    type: str
    bounds: str
    description: str


def connect(
    endpoint: str = "",
    domain: int | None = None,
    robot: str = "",
    *,
    notify: Callable[[str], None] = _log.warning,
) -> Robot:
    """Connect to a robot of a running deployment; use the result in a `with` statement.

    Args:
        endpoint: where the router of the deployment listens: the path of a Unix socket, or
            `tcp/HOST:PORT`; by default the socket of this user's deployment in the domain.
        domain: its ROS domain; by default that of `ROS_DOMAIN_ID`, else 0.
        robot: its name; not needed if one robot alone is on the bus.
        notify: called with remarks, such as that a component does not answer yet.

    Raises:
        CairnError: if no router answers there.
    """
    return Robot(Connection.open(endpoint, domain), robot, notify)


class Robot(Closing):
    """A robot on the bus. Components and topics may be given by short or by full name."""

    def __init__(
        self,
        connection: Connection,
        robot: str = "",
        notify: Callable[[str], None] = _log.warning,
    ) -> None:
        """Take over a connection; `close` closes it."""
        self.connection = connection
        self._robot = robot
        self._prefix = f"/{robot}/" if robot else "/"  # of all names of the robot, or of any
        self._notify = notify
        self._codec = Codec()
        self._publishers = Publishers(connection)
        self._subscriptions: set[Subscription[Any]] = set()
        self._listeners: set[TransformListener] = set()

    def close(self) -> None:
        """End all subscriptions and the connection."""
        for subscription in tuple(self._subscriptions):
            subscription.close()
        for listener in tuple(self._listeners):
            listener.close()
        self.connection.close()

    @property
    def name(self) -> str:
        """Name of the robot; `CairnError` if there is none, or several and none was given."""
        robots = self._robots()
        check_robot(self._robot, robots)
        if self._robot:
            return self._robot
        if len(robots) != 1:
            if not robots:
                raise CairnError(f"no robot is on the bus{self.connection.elsewhere()}")
            listed = ", ".join(sorted(robots))
            raise CairnError(
                f"which robot is meant? On the bus there are: {listed}; give --robot (robot=...)"
            )
        return robots.pop()

    def components(self) -> dict[str, ComponentStatus]:
        """Return the last status of each running component, by its name."""
        prefix = f"/{self.name}/"
        statuses = sorted(self.connection.statuses().items())
        return {
            full.removeprefix(prefix): status
            for full, status in statuses
            if full.startswith(prefix)
        }

    def component_of(self, plugin: str) -> str | None:
        """Return the full name of the running component of a plugin; None if there is none."""
        running = self.connection.find(
            lambda statuses: [
                full
                for full, status in statuses.items()
                if status.plugin == plugin and full.startswith(self._prefix)
            ]
        )
        if not running:
            return None
        return resolve(running, running[0].rpartition("/")[2], self._robot)

    def topics(self) -> list[Topic]:
        """Return all topics, sorted; those of the given robot alone if one was given."""
        by_name: defaultdict[str, list[keys.EndpointEntity]] = defaultdict(list)
        for end in self.connection.endpoints():
            if end.topic.startswith(self._prefix) or end.node.name.startswith(self._prefix):
                by_name[end.topic].append(end)
        return [one for _, ends in sorted(by_name.items()) for one in _topics_of(ends)]

    def topic_info(self, topic: str) -> TopicInfo:
        """Return the publishers and subscribers of a topic (short or full name), with their QoS.

        Raises `CairnError` if there is no such topic.
        """
        graph = self.connection.endpoints()
        full = self._resolve({end.topic for end in graph}, topic)
        ends = [end for end in graph if end.topic == full]
        found = sorted(map(endpoint_of, ends), key=lambda end: (end.role, end.node))
        return TopicInfo(full, tuple(found), problems_of(ends))

    def nodes(self) -> list[NodeInfo]:
        """Return all nodes on the bus, of ROS 2, too; with a given robot only those in its name."""
        return [one for one in read_nodes(self.connection) if one.name.startswith(self._prefix)]

    def find_topic(self, topic: str) -> keys.EndpointEntity:
        """Return a publisher of a topic, or a subscription if nothing publishes it.

        If components use the topic, it has their type.

        Raises `CairnError` if there is no such topic, or if it is used with several types.
        """
        endpoints = self.connection.endpoints()
        topics = {end.topic for end in endpoints}
        name = f"/{topic.removeprefix('/')}"
        if not any(one.endswith(name) for one in topics):  # an error lists those of own components
            topics = {one for one in topics if not keys.is_infrastructure(one)} or topics
        full = self._resolve(topics, topic)
        ends = [end for end in endpoints if end.topic == full]
        # A foreign node with another type must not keep the components' topic from its users.
        ours = {end.type_name for end in ends if not end.node.is_foreign}
        types = sorted(ours or {end.type_name for end in ends})
        if len(types) > 1:
            raise CairnError(f"{full} is used with several message types: {', '.join(types)}")
        ends = [end for end in ends if end.type_name in types]
        return next((end for end in ends if end.kind == "MP"), ends[0])

    def subscribe(
        self,
        topic: str,
        message: type[M],
        callback: Callable[[M], None] | None = None,
        *,
        depth: int = 1000,
        timeout_s: float = 10.0,
    ) -> Subscription[M]:
        """Subscribe to a topic, which need not exist yet; latched messages arrive first.

        Args:
            topic: short name (`pose`) or full name (`/robot/pose`).
            message: class of its messages.
            callback: called with each message on a thread of its own; without it, iterate over
                the subscription or call `next`.
            depth: number of newest messages kept for the reader, of 64 MiB at most; older ones are
                dropped.
            timeout_s: `next` and iteration raise `NoMessageError` after that time [s] without one.

        Raises:
            CairnError: if the topic is used with another message type.
        """
        full = self._full(topic)
        self._check_type(full, message)
        return Subscription(
            self.connection, self._subscriptions, full, message, callback, depth, timeout_s
        )

    def latest(self, topic: str, message: type[M], *, timeout_s: float = 5.0) -> M:
        """Return the newest latched message of a topic, or else the next one that is published."""
        with self.subscribe(topic, message, depth=1) as subscription:
            samples, _ = self.connection.cached(subscription.key)
            if samples:
                newest = max(samples, key=keys.sent_ns)
                return self._codec.decode(message, newest.payload.to_bytes())
            return subscription.next(timeout_s)

    def services(self) -> list[ServiceInfo]:
        """Return all services, sorted; those of the given robot alone if one was given."""
        return self._of_robot(find_services(self.connection)[0])

    def actions(self) -> list[ServiceInfo]:
        """Return all actions, sorted; those of the given robot alone if one was given."""
        return self._of_robot(find_services(self.connection)[1])

    def call(
        self,
        service: str,
        kind: type[Service[Request, Response]],
        request: Request,
        *,
        timeout_s: float = _REPLY_LIMIT_S,
    ) -> Response:
        """Call a service and return the response.

        Args:
            service: short name (`save_map`) or full name (`/robot/save_map`).
            kind: class of the service, such as `cairn.schemas.nav2_msgs.srv.SaveMap`.
            request: a `kind.Request`.
            timeout_s: limit for the answer [s].

        Raises:
            ServiceError: if there is no server of this type, it refuses the call, ends, or does not
                answer in time.
        """
        return call_service(self.connection, self._full(service), kind, request, timeout_s)

    def send_goal(
        self,
        action: str,
        kind: type[Action[Goal, Result, Feedback]],
        goal: Goal,
        *,
        timeout_s: float = _REPLY_LIMIT_S,
    ) -> RunningGoal[Goal, Result, Feedback]:
        """Send a goal to an action and return it; use it in a `with` statement.

        Args:
            action: short name (`navigate_to_pose`) or full name.
            kind: class of the action, such as `cairn.schemas.nav2_msgs.action.NavigateToPose`.
            goal: a `kind.Goal`.
            timeout_s: limit for its acceptance [s].

        Raises:
            ServiceError: if there is no server of this type, or it rejects the goal.
        """
        sent = RunningGoal(self.connection, self._full(action), kind, goal, timeout_s)
        try:
            sent.await_acceptance()
        except BaseException:
            sent.close()
            raise
        return sent

    def _of_robot(self, found: list[ServiceInfo]) -> list[ServiceInfo]:
        return [one for one in found if one.name.startswith(self._prefix)]

    def transforms(
        self, cache_s: float = 10.0, *, on_problem: Callable[[str], None] | None = None
    ) -> TransformListener:
        """Read the robot's transforms on a thread, until the result or the robot is closed.

        If no robot of Cairn is on the bus and none was given, those on `/tf` and `/tf_static`
        alone are read.

        Args:
            cache_s: how long transforms are kept [s].
            on_problem: called with each problem once, such as a frame with two parents; by default
                `notify` of `connect`.

        Raises:
            CairnError: if several robots are on the bus and none was given.
        """
        robot = self.name if self._robot or self._robots() else ""
        buffer = Buffer(cache_s, on_problem=on_problem or self._notify)
        return TransformListener(self.connection, robot, buffer, self._listeners)

    def publish(self, topic: str, message: Any) -> str:
        """Publish one message and return the topic's full name.

        Raises `CairnError` if no component subscribes to the topic with this message type, or the
        user on the network may not publish on it.
        """
        key = keys.message_key(self.connection.domain, topic, type(message))
        # Reading the graph takes longer than publishing: not for each of many messages.
        if topic.startswith("/") and self._publishers.reaches_subscriber(key):
            full = topic
        else:
            full = self._subscribed_topic(topic, type(message))
            key = keys.message_key(self.connection.domain, full, type(message))
        self._publishers.put(key, type_name(type(message)), self._codec.encode(message))
        return full

    def _robots(self) -> set[str]:
        """Return the names of the robots on the bus."""
        status_type = type_name(ComponentStatus)
        return {
            end.node.name.split("/")[1]
            for end in self.connection.endpoints(f"*/{STATUS_TOPIC}")
            if end.kind == "MP" and end.type_name == status_type
        }

    def _subscribed_topic(self, topic: str, message: type[Any]) -> str:
        """Return the full name of a topic to which something subscribes with a message type."""
        readers = [end for end in self.connection.endpoints() if end.kind == "MS"]
        topics = {end.topic for end in readers if end.type_name == type_name(message)}
        try:
            return resolve(topics, topic, self._robot)
        except CairnError as error:
            raise CairnError(
                f"{topic} is not published: nothing subscribes to it with "
                f"{type_name(message)} ({error})"
            ) from error

    def request(
        self,
        component: str,
        verb: str,
        arguments: Mapping[str, Any] | None = None,
        *,
        timeout_s: float = _REPLY_LIMIT_S,
    ) -> Any:
        """Send a control request to a component and return its reply (JSON values).

        Raises `ControlError` if the component rejects it, `NoReplyError` if it does not reply.
        """
        full = self._resolve(self.connection.nodes(), component)
        return self.connection.request(full, verb, arguments, timeout_s=timeout_s)

    def request_plugin(
        self,
        plugin: str,
        verb: str,
        arguments: Mapping[str, Any] | None = None,
        *,
        missing: str,
        timeout_s: float = _REPLY_LIMIT_S,
    ) -> Any:
        """Send a control request to the running component of a plugin and return its reply.

        Raises `CairnError` with `missing`, what to do, if there is none; else as `request`.
        """
        name = self.component_of(plugin)
        if name is None:
            raise CairnError(f"no {plugin} is running: {missing}")
        return self.request(name, verb, arguments, timeout_s=timeout_s)

    def parameters(self, component: str) -> dict[str, Parameter]:
        """Return the parameters of a running component, by dotted name."""
        entries = self.request(component, "parameters")
        return {entry["name"]: Parameter(**entry) for entry in entries}

    def set_parameters(self, component: str, values: Mapping[str, Any]) -> None:
        """Change parameters of a running component, all or none, until it is restarted.

        Raises `ControlError` with the allowed values if the component rejects one.
        """
        self.request(component, "set_parameters", values)

    def load(self, component: str) -> str:
        """Start a component of the deployment that is not loaded; return its state."""
        return self._manage("load", component)

    def unload(self, component: str) -> str:
        """Stop a component and leave it stopped; return its state."""
        return self._manage("unload", component)

    def restart(self, component: str) -> str:
        """Stop a component and start it again; return its state."""
        return self._manage("restart", component)

    def logs(self, component: str = "") -> list[Log]:
        """Return the last log messages of the running components, oldest first.

        If a component does not answer, the others' messages are returned and `notify` is called.
        """
        key = keys.message_key(self.connection.domain, ROSOUT, Log)
        samples, complete = self.connection.cached(key)
        if not complete:
            self._notify(
                "a component does not answer; its log file is in logs/ of the run's folder"
            )
        entries = []
        for payload in dict.fromkeys(sample.payload.to_bytes() for sample in samples):
            try:
                entries.append(self._codec.decode(Log, payload))
            except InvalidMessage:
                continue  # of a foreign node
        found = [entry for entry in entries if self._is_of(entry, component)]
        if not found:
            self._check_logger(component)
        return sorted(found, key=lambda entry: (entry.stamp.sec, entry.stamp.nanosec))

    def follow_logs(
        self, component: str = "", *, timeout_s: float = float("inf")
    ) -> Subscription[Log]:
        """Subscribe to log messages; those that components keep arrive first."""
        self._check_logger(component)
        return Subscription(
            self.connection, self._subscriptions, ROSOUT, Log, None, 10_000, timeout_s,
            accept=lambda entry: self._is_of(entry, component),
        )  # fmt: skip

    @overload
    def go(self, x: str) -> NavigationGoal: ...
    @overload
    def go(self, x: float, y: float, theta: float = 0.0) -> NavigationGoal: ...
    def go(self, x: float | str, y: float = 0.0, theta: float = 0.0) -> NavigationGoal:
        """Send the robot to a pose in frame map [m, m, rad], or to a place by its name.

        This preempts an earlier goal. Raises `CairnError` with the known places if there is no
        place of that name on the map.
        """
        return self.go_through([x if isinstance(x, str) else (x, y, theta)])

    def go_through(self, poses: Sequence[tuple[float, float, float] | str]) -> NavigationGoal:
        """Send the robot to several poses in frame map or places, at most 1,000, one by one."""
        goal = self.missions().goal(poses)
        try:
            goal.send()
        except (KeyboardInterrupt, SystemExit):  # it may have been accepted
            with suppress(CairnError):
                goal.cancel()
            raise
        return goal

    def cancel(self) -> str:
        """Cancel the current goal of any client; return its id in hexadecimal digits."""
        return self.missions().cancel()

    def missions(self) -> MissionClient:
        """Return the robot's supervisor that accepts goals, once it answers."""
        return MissionClient.find(self.connection, self._robot, self._notify)

    def stop(self, reason: str = "requested by a client") -> VelocityGateStatus:
        """Engage the emergency stop at the velocity gate; return the gate's confirmation.

        Raises `CairnError` with a remedy if the gate does not confirm it within a second.
        """
        return set_emergency_stop(self, self._robot, reason)

    def release_stop(self) -> VelocityGateStatus:
        """Release the emergency stop; a goal that is under way goes on."""
        return set_emergency_stop(self, self._robot, None)

    def teleoperation(self, operator: str, *, take_over: bool = False) -> Teleoperation:
        """Acquire the operator's lease for driving; use the result in a `with` statement.

        Raises `CairnError` if another operator has it, unless it is taken over, which needs the
        role administer.
        """
        gate = find_gate(self, self._robot)
        return Teleoperation(
            lambda verb, arguments: self.connection.request(
                gate.name, verb, arguments, timeout_s=_REPLY_LIMIT_S
            ),
            lambda command: self.publish(gate.topics["teleoperation"], command),
            operator,
            take_over=take_over,
        )

    def _manage(self, verb: str, component: str) -> str:
        supervisor, child = self._supervisor_of(component)
        return str(
            self.connection.request(supervisor, verb, {"name": child}, timeout_s=_START_LIMIT_S)
        )

    def _supervisor_of(self, name: str) -> tuple[str, str]:
        """Return the full name of the supervisor of a component, and the component's short name."""
        known: dict[str, str] = {}
        running: dict[str, str] = {}
        for node, status in self.connection.statuses().items():
            of_robot = node.split("/")[1]
            if self._robot and of_robot != self._robot:
                continue
            running[node] = status.machine
            for child in status.children:
                known[f"/{of_robot}/{child}"] = node
        full = resolve([*known, *running], name, self._robot)
        short = full.rpartition("/")[2]
        if full not in known and short in ("root", f"root_{running[full]}"):
            raise CairnError(
                f"{full} has no supervisor: it is the process of `cairn up`; end that, or start it "
                "again"
            )
        if full not in known:
            raise CairnError(f"{full}: its supervisor does not answer; see `cairn ps`")
        return known[full], short

    def _check_logger(self, component: str) -> None:
        writers = {end.node.name for end in self.connection.endpoints(ROSOUT) if end.kind == "MP"}
        check_robot(self._robot, (name.split("/")[1] for name in writers))
        if component:
            resolve(writers, component, self._robot)

    def _is_of(self, entry: Log, component: str) -> bool:
        of_robot, _, name = entry.name.partition(".")
        return component in ("", name) and self._robot in ("", of_robot)

    def _resolve(self, names: Collection[str], name: str) -> str:
        """Return the full name that `name` means, as `resolve`; names other domains if none."""
        if not names:
            raise CairnError(
                f"there is no {name}: nothing runs in domain {self.connection.domain}"
                f"{self.connection.elsewhere()}"
            )
        return resolve(names, name, self._robot)

    def _full(self, topic: str) -> str:
        return topic if topic.startswith("/") else f"/{self.name}/{topic}"

    def _check_type(self, topic: str, message: type[Any]) -> None:
        ours = type_name(message)
        ends = self.connection.endpoints(topic)
        if ends and all(end.type_name != ours for end in ends):
            end = ends[0]
            raise CairnError(
                f"{topic}: {end.node.name} uses it with {end.type_name}, not with {ours}; "
                "subscribe with that message type"
            )


def _topics_of(ends: list[keys.EndpointEntity]) -> Iterator[Topic]:
    """Yield a topic for each message type with which one name is used."""
    problems = problems_of(ends)
    for message in sorted({end.type_name for end in ends}):
        found = [endpoint_of(end) for end in ends if end.type_name == message]
        publishers, subscribers = nodes_in(found, "publisher"), nodes_in(found, "subscriber")
        name = found[0].name
        yield Topic(name, message, publishers, subscribers, foreign_in(found), problems)

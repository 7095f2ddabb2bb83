"""Services and actions of a robot, as a script uses them."""

from __future__ import annotations

import queue
import secrets
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from cairn.bus import keys
from cairn.bus.actions import ActionCaller, make_at_once
from cairn.bus.bus import ServiceError
from cairn.bus.codec import Codec
from cairn.bus.services import ZenohClient
from cairn.bus.type_hash import type_hash
from cairn.client.connection import Connection
from cairn.client.graph import Endpoint, endpoint_of, foreign_in, nodes_in, problems_of
from cairn.errors import CairnError
from cairn.schemas.message import Action, Service, type_name
from cairn.system.closing import Closing

Request = TypeVar("Request")
Response = TypeVar("Response")
Goal = TypeVar("Goal")
Result = TypeVar("Result")
Feedback = TypeVar("Feedback")

_DISCOVERY_S = 2.0  # until what a router knows of servers has arrived


@dataclass(frozen=True)
class ServiceInfo:
    """A service or an action on the bus.

    Attributes:
        name: full name, `/robot/save_map`.
        type_name: its type in ROS 2.
        servers: full names of the nodes that provide it.
        clients: full names of the nodes that use it.
        foreign: full names of those nodes that are not components of Cairn.
        problems: what keeps servers and clients of this name apart, such as two types.
    """

    name: str
    type_name: str
    servers: tuple[str, ...]
    clients: tuple[str, ...]
    foreign: tuple[str, ...] = ()
    problems: tuple[str, ...] = ()


def find_services(connection: Connection) -> tuple[list[ServiceInfo], list[ServiceInfo]]:
    """Return the services on the bus, without those that are part of an action, and the actions."""
    found: defaultdict[tuple[bool, str, str], list[Endpoint]] = defaultdict(list)
    entities: defaultdict[tuple[bool, str], list[keys.EndpointEntity]] = defaultdict(list)
    for entity in connection.endpoints(kind="S$*"):
        end = endpoint_of(entity)
        if not end.is_part_of_action:
            is_action = end.role.startswith("action")
            found[is_action, end.name, end.type_name].append(end)
            entities[is_action, end.name].append(entity)
    services: tuple[list[ServiceInfo], list[ServiceInfo]] = ([], [])
    for (is_action, name, kind), ends in sorted(found.items()):
        info = ServiceInfo(
            name, kind,
            nodes_in(ends, "service server", "action server"),
            nodes_in(ends, "service client", "action client"),
            foreign_in(ends), problems_of(entities[is_action, name]),
        )  # fmt: skip
        services[is_action].append(info)
    return services


def service_client(
    connection: Connection,
    name: str,
    service: type[Service[Any, Any]],
    on_available: Callable[[], None] = lambda: None,
) -> ZenohClient:
    """Return a client of a service (full name), whose answers arrive on Zenoh's threads.

    So does the news that there is a server, `on_available`.
    """
    key = keys.data_key(connection.domain, name, type_name(service), type_hash(service))
    return ZenohClient(
        connection.session, Codec(), name, key, secrets.token_bytes(16), service,
        make_at_once, make_at_once, on_available=on_available,
    )  # fmt: skip


def call_service(
    connection: Connection,
    name: str,
    service: type[Service[Request, Response]],
    request: Request,
    timeout_s: float,
) -> Response:
    """Call a service (full name) and return its response; raises `ServiceError`."""
    changed = threading.Event()
    client = service_client(connection, name, service, changed.set)
    try:
        await_server(
            connection, name, type_name(service), lambda: client.is_available, changed, timeout_s
        )
        outcome: queue.Queue[Any] = queue.Queue()
        client.call(request, outcome.put, outcome.put, timeout_s)
        try:
            answer = outcome.get(timeout=timeout_s + _DISCOVERY_S)
        except queue.Empty:
            raise ServiceError(f"{name}: no answer within {timeout_s:g} s") from None
        if isinstance(answer, ServiceError):
            raise answer
        return answer  # type: ignore[no-any-return]
    finally:
        client.close()


def await_server(
    connection: Connection,
    name: str,
    kind: str,
    is_available: Callable[[], bool],
    changed: threading.Event,
    timeout_s: float,
) -> None:
    """Wait until a server is known here; `ServiceError` with what there is if there is none.

    `changed` is set when `is_available` may have become true.
    """
    deadline = time.monotonic() + min(timeout_s, _DISCOVERY_S)
    while not is_available():
        if not changed.wait(max(0.0, deadline - time.monotonic())):
            raise ServiceError(_no_server(connection, name, kind))
        changed.clear()


def _no_server(connection: Connection, name: str, kind: str) -> str:
    services, actions = find_services(connection)
    for one in (*services, *actions):
        if one.name == name and one.servers and one.type_name != kind:
            return f"{name} has type {one.type_name}, not {kind}"
        if one.name == name and one.servers:
            return (
                f"{name}: its server {one.servers[0]} has another definition of {kind}, or cannot "
                "be reached: over the network, your role may not use it"
            )
    return f"{name}: there is no server; `cairn service list` and `cairn action list` show all"


class RunningGoal(Closing, Generic[Goal, Result, Feedback]):
    """A goal that was sent to an action server: iterate over its feedback, await its result."""

    def __init__(
        self,
        connection: Connection,
        name: str,
        action: type[Action[Goal, Result, Feedback]],
        goal: Goal,
        timeout_s: float,
        identity: bytes | None = None,
    ) -> None:
        """Send a goal to an action (full name), with a random id if none is given.

        Raises `ServiceError` if there is no server.
        """
        self._changed = threading.Condition()
        self._name = name
        self._timeout_s = timeout_s
        self._seen = 0
        self._closed = False
        changed = threading.Event()
        self._caller: ActionCaller[Goal, Result, Feedback] = ActionCaller(
            name,
            action,
            lambda one, service: service_client(connection, one, service, changed.set),
            self._notify,
        )
        key = keys.message_key(
            connection.domain, self._caller.feedback_topic, action.FeedbackMessage
        )
        codec, message = Codec(), action.FeedbackMessage

        def receive(sample: Any) -> None:
            try:
                feedback = codec.decode(message, sample.payload.to_bytes())
            except ValueError:
                return  # of a false publisher
            self._caller.receive_feedback(feedback)

        self._subscriber = connection.subscriber(key, receive, latched=False)
        try:
            await_server(
                connection,
                name,
                type_name(action),
                lambda: self._caller.is_available,
                changed,
                timeout_s,
            )
        except BaseException:
            self.close()
            raise
        self._sent = self._caller.send(identity or secrets.token_bytes(16), goal, timeout_s)

    @property
    def id(self) -> str:
        """The goal's id: 32 hexadecimal digits."""
        return self._sent.id.hex()

    @property
    def has_ended(self) -> bool:
        """Whether it has a result, or is lost."""
        return self._sent.has_ended

    def await_acceptance(self) -> None:
        """Wait until the goal is accepted; raises `ServiceError` if it is not."""
        with self._changed:
            self._changed.wait_for(
                lambda: self._sent.is_accepted or self._sent.has_ended,
                self._timeout_s + _DISCOVERY_S,
            )
        if self._sent.is_accepted:
            return
        if self._sent.error is not None:
            raise self._sent.error
        raise ServiceError(f"{self._name}: the goal was not answered in {self._timeout_s:g} s")

    def await_end(self, timeout_s: float | None = None) -> bool:
        """Wait until the goal has ended, at most so long [s]; return whether it has."""
        with self._changed:
            return self._changed.wait_for(lambda: self._sent.has_ended, timeout_s)

    def resume(self) -> None:
        """Wait again for the end of the goal: its server had ended, and has restored it."""
        self._caller.resume(self._sent)

    def __iter__(self) -> Iterator[Feedback]:
        """Yield the feedback until the goal has ended."""
        while True:
            with self._changed:
                self._changed.wait_for(
                    lambda: self._seen < len(self._sent.feedback) or self._sent.has_ended
                )
                if self._seen >= len(self._sent.feedback):
                    return
                feedback = self._sent.feedback[self._seen]
                self._seen += 1
            yield feedback

    def result(self, timeout_s: float | None = None) -> tuple[int, Result]:
        """Wait for the end; return the final status and the result.

        The status is one of the constants of `action_msgs/msg/GoalStatus`. Raises `ServiceError` if
        the server ended, `CairnError` if the goal has not ended within `timeout_s` [s]; it is not
        canceled then.
        """
        if not self.await_end(timeout_s):
            raise CairnError(f"{self._name}: the goal has not ended within {timeout_s:g} s")
        if self._sent.error is not None:
            raise self._sent.error
        assert self._sent.status is not None
        assert self._sent.result is not None
        return self._sent.status, self._sent.result

    def cancel(self, timeout_s: float = 5.0) -> bool:
        """Request that it is canceled; return whether the server accepts that."""
        self._sent.cancel()
        with self._changed:
            self._changed.wait_for(lambda: self._sent.cancel_code is not None, timeout_s)
        return self._sent.cancel_code == 0

    def close(self) -> None:
        """Receive nothing more; the goal itself continues."""
        if not self._closed:
            self._closed = True
            self._subscriber.undeclare()
            self._caller.close()

    def _notify(self) -> None:
        with self._changed:
            self._changed.notify_all()

"""Makes the recorded calls into one component again, and compares what it publishes.

The component runs in its own `Runtime`. The bus, the clock and the scheduler beside it give it what
the call log and the recording have: nothing else decides what it does.
"""

import json
import logging
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, NamedTuple, Protocol

from cairn.bus.bus import (
    ClientOptions,
    MessageId,
    Node,
    PublisherOptions,
    Report,
    ServerOptions,
    ServiceError,
    SubscriptionOptions,
    full_name,
)
from cairn.bus.codec import Codec
from cairn.bus.type_hash import type_hash
from cairn.deployment.plugins import load_plugin
from cairn.errors import CairnError
from cairn.processes.logged_children import RecordedChildren
from cairn.processes.supervisor import Supervisor
from cairn.rerun.call_environment import CallEnvironment, CannotRerun, Sent
from cairn.rerun.call_logs import ComponentStart, RecordedCall
from cairn.rerun.comparison import first_difference
from cairn.rerun.rerun_services import RerunCall, RerunClient, RerunServer
from cairn.rerun.result import Difference, RerunResult, TopicResult
from cairn.runtime.call_records import RecordKind, StartInfo
from cairn.runtime.child_spec import ChildSpec
from cairn.runtime.launch_request import LaunchRequest, RunContext
from cairn.runtime.lifecycle import Transition
from cairn.runtime.ports import actions_of, ports_of, services_of
from cairn.runtime.process_exit import ExitReport
from cairn.runtime.runtime import Runtime
from cairn.runtime.timers import CLOCK_TOPIC
from cairn.schemas.builtin_interfaces import from_ns
from cairn.schemas.message import InvalidMessage, type_name
from cairn.schemas.rosgraph_msgs import Clock as ClockMessage
from cairn.system.clock import SECOND

_MOST_NOTES: Final = 20
_log = logging.getLogger("cairn.rerun")


class Payload(NamedTuple):
    """A recorded message: its CDR, its type's hash ("" if unknown), and when it was sent [ns]."""

    data: bytes
    type_hash: str
    sent_ns: int


class RecordedMessages(Protocol):
    """The messages of a recording, by publisher and number."""

    def find(self, message: MessageId) -> Payload | None:
        """Return a message; None if it was not recorded."""


class _Cut(BaseException):
    """The log ends during this call."""


class Rerun:
    """Runs one component again, from a start of it on."""

    def __init__(
        self,
        start: ComponentStart,
        info: StartInfo,
        messages: RecordedMessages,
        until_ns: int | None = None,
        stop_at_difference: bool = False,
        on_call: Callable[[int, str], object] = lambda _time_ns, _name: None,
    ) -> None:
        """Prepare to run `start` again.

        Args:
            start: its call log.
            info: with what to start it; its paths may differ from those of the log.
            messages: the recorded messages.
            until_ns: make no calls at or after this time [ns].
            stop_at_difference: make no calls after the one with the first difference.
            on_call: called with time [ns] and name of each call before it is made.
        """
        self.result = RerunResult(start.component, start.incarnation)
        self.ended: ExitReport | None = None
        self.time_ns = start.started_ns
        self.codec = Codec()
        self.published: list[tuple[str, int, Any]] = []
        self._start = start
        self._info = info
        self._messages = messages
        self._until_ns = until_ns
        self._stop_at_difference = stop_at_difference
        self._on_call = on_call
        self._gids: dict[str, bytes] = {}
        self._call = CallEnvironment("its start")
        self._call_ns = start.started_ns
        self._subscriptions: dict[str, _RerunSubscription] = {}
        self._scheduler = _RerunScheduler()
        self._ports: dict[str, str] = {}  # by topic
        self._service_ports: dict[str, str] = {}  # by service
        self._servers: dict[str, RerunServer] = {}
        self._clients: dict[str, RerunClient] = {}
        self._runtime: Runtime | None = None

    def run(self) -> RerunResult:
        """Make all calls. Raises `RecordingError` if the log is damaged."""
        result = self.result
        try:
            calls = self._start.calls()
            following = next(calls, None)
            while (call := following) is not None:
                following = next(calls, None)
                if not self._make(call, is_last=following is None):
                    return result
                result.calls += 1
        except _Cut:
            return result
        except CannotRerun as error:
            result.incomplete = str(error)
            return result
        except ValueError as error:  # of the log: those of the component are its own failures
            result.incomplete = f"its call log is damaged, in {self._call.name}: {error}"
            return result
        result.incomplete = self._start.missing
        return result

    def _make(self, call: RecordedCall, *, is_last: bool) -> bool:
        """Make one call; return whether there should be further ones."""
        environment = CallEnvironment(call.description)
        for record in call.events:
            environment.add(record, self._gids)
        # The recording, or the process, may have ended during the last call.
        environment.is_cut = is_last and environment.end is None
        if self._until_ns is not None and call.time_ns >= self._until_ns:
            return False
        self.time_ns, self._call, self._call_ns = call.time_ns, environment, call.time_ns
        if self.ended is not None:
            return True  # the recorded component did nothing more either, or the end is reported
        self._on_call(call.time_ns, environment.name)
        self._enter(call)
        self._check_rest(environment)
        return not (self._stop_at_difference and self.result.first is not None)

    def _enter(self, call: RecordedCall) -> None:
        runtime, values = self._runtime, call.record[1:]
        if call.kind is RecordKind.START:
            try:
                self._runtime = self._constructed()
            except CairnError as error:
                raise CannotRerun(str(error)) from error
            return
        if runtime is None:
            raise CannotRerun("the log has no start")
        match call.kind:
            case RecordKind.TRANSITION:
                self._rejecting(lambda: runtime.transition(Transition(values[0])))
            case RecordKind.MESSAGE:
                self._deliver(values[0], MessageId(values[1], values[2]))
            case RecordKind.CALLED:
                server = self._servers.get(values[0])
                if server is None:
                    self._note(f"does not serve {values[0]} in {self._call.name}")
                else:
                    server.deliver(self.call_of(server, values[1:]))
            case RecordKind.ANSWERED | RecordKind.FAILED:
                self._answer(call.kind, values[0], values[1], values[2])
            case RecordKind.CLOCK:
                subscription = self._subscriptions.get(CLOCK_TOPIC)
                if subscription is None:
                    raise CannotRerun("the component does not follow topic clock any more")
                clock = ClockMessage(clock=from_ns(values[0]))
                subscription.deliver(clock, MessageId(bytes(16), 0))
            case RecordKind.TIMERS:
                self._scheduler.on_time()
            case RecordKind.POSTED:
                if not self._scheduler.make_posted():
                    self._differ("", "no call is posted, as there was in the recording")
            case RecordKind.REQUEST:
                verb, arguments = values[0], json.loads(values[1])
                self._rejecting(lambda: runtime.request(verb, arguments))
            case RecordKind.HOST if values[0] == "reconcile":
                component = runtime.component
                if isinstance(component, Supervisor):
                    runtime.run("supervision", component.reconcile)
            case RecordKind.FOREIGN:
                raise CannotRerun("a thread of its own called it, which cannot be repeated")
            case _:
                raise CannotRerun(f"{call.description} cannot be repeated")

    def _constructed(self) -> Runtime:
        info = self._info
        plugin = load_plugin(info.plugin)

        def on_bus(port: str) -> str:
            return full_name(info.robot, info.topics.get(port, port))

        self._ports = {on_bus(port): port for port in ports_of(plugin)}
        self._service_ports = {on_bus(port): port for port in services_of(plugin)}
        for action in actions_of(plugin).values():
            name = on_bus(action.name)
            for part, topic in action.topics().items():
                self._ports[f"{name}/{part}"] = topic.name
            for part, service in action.services().items():
                self._service_ports[f"{name}/{part}"] = service.name
        self._ports.setdefault(on_bus(CLOCK_TOPIC), CLOCK_TOPIC)
        children = {name: ChildSpec(plugin="none") for name in info.children}
        launch = LaunchRequest(
            name=info.name,
            spec=ChildSpec(
                plugin=info.plugin,
                parameters=info.parameters,
                topics=info.topics,
                max_age_s=info.max_age_s,
                children=children,
            ),
            incarnation=info.incarnation,
            context=RunContext(
                robot=info.robot,
                seed=info.seed,
                simulated_time=info.simulated_time,
                lockstep=info.lockstep,
            ),
        )
        runtime = Runtime(plugin, launch, _RerunBus(self), self._scheduler, self, self._on_end)
        runtime.heartbeat.close()
        if isinstance(runtime.component, Supervisor):
            runtime.component.adopt_recorded(RecordedChildren(self.outcome), self._scheduler.post)
        return runtime

    def _deliver(self, port: str, identity: MessageId) -> None:
        subscription = self._subscriptions.get(port)
        if subscription is None:
            self._note(f"does not subscribe to input {port} in {self._call.name}")
            return
        subscription.deliver(self.message(subscription, identity), identity)

    def call_of(self, server: RerunServer, values: Sequence[Any]) -> RerunCall:
        """Return a recorded call of a server, from the identity and the request in its record."""
        gid, sequence, content = values
        return RerunCall(server, self._decoded(server.service.Request, content), gid, sequence)

    def _answer(self, kind: RecordKind, port: str, sequence: int, content: Any) -> None:
        client = self._clients.get(port)
        pending = None if client is None else client.pending.pop(sequence, None)
        if client is None or pending is None:
            self._note(f"does not wait for the answer {sequence} of {port} in {self._call.name}")
        elif kind is RecordKind.FAILED:
            pending[1](ServiceError(content))
        else:
            pending[0](self._decoded(client.service.Response, content))

    def _decoded(self, cls: type[Any], content: bytes) -> Any:
        try:
            return self.codec.decode(cls, content)
        except InvalidMessage as error:
            raise CannotRerun(
                f"{type_name(cls)}: a recorded message is invalid now: {error}"
            ) from error

    def open_server(self, server: RerunServer) -> str:
        """Note a server; return the name of its port."""
        port = self._service_ports[server.name]
        self._servers[port] = server
        return port

    def open_client(self, client: RerunClient) -> str:
        """Note a client; return the name of its port."""
        port = self._service_ports[client.name]
        self._clients[port] = client
        return port

    def close_service(self, port: str) -> None:
        """Forget the server or client of a port."""
        self._servers.pop(port, None)
        self._clients.pop(port, None)

    def pending_call(self, server: RerunServer) -> RerunCall | None:
        """Return a call that was taken from a server within another call; None if none was."""
        waiting = self._call.pending_calls.get(server.port)
        return self.call_of(server, waiting.popleft()) if waiting else None

    def saw_server(self, port: str) -> bool:
        """Return whether the component saw a server for its client."""
        return self._saw(port, "there is a server for")

    def compare_sent(self, service: str, port: str, what: str, sent: Sent) -> None:
        """Compare what was sent by a service with the recording: an answer, a refusal, a call."""
        result = self.result.topics.setdefault(service, TopicResult())
        expected = self._call.service_sent.get(port)
        if not expected:
            if not self._call.is_cut:
                result.extra += 1
                self._differ(service, f"sends {what} more: {_shortened(sent.content)}")
            return
        recorded = expected.popleft()
        result.compared += 1
        if recorded != sent:
            result.different += 1
            self._differ(
                service,
                f"sends {what} {_shortened(sent.content)}; recorded was "
                f"{_shortened(recorded.content)}",
            )

    def message(self, subscription: "_RerunSubscription", identity: MessageId) -> Any:
        """Return a recorded message for an input; raises `CannotRerun` if it is missing."""
        topic, cls = subscription.topic, subscription.message
        if identity.sequence <= 0:
            raise CannotRerun(
                f"{topic}: a message at {self.time_ns / SECOND:.6f} s has no number, because its "
                "publisher numbers none, so that it cannot be found in the recording"
            )
        payload = self._messages.find(identity)
        if payload is None:
            raise CannotRerun(
                f"{topic}: message {identity.sequence} of its publisher, which the component "
                f"received at {self.time_ns / SECOND:.6f} s, is not in the recording"
            )
        if payload.type_hash and payload.type_hash != type_hash(cls):
            raise CannotRerun(
                f"{topic}: the definition of its messages has changed since the recording"
            )
        try:
            return self.codec.decode(cls, payload.data)
        except InvalidMessage as error:
            raise CannotRerun(f"{topic}: a recorded message is invalid now: {error}") from error

    def now(self) -> int:
        """Return the next reading of the clock that was logged [ns]."""
        if self._call.times:
            self.time_ns = self._call.times.popleft()
        else:
            self._note(f"reads the clock more often in {self._call.name}")
        return self.time_ns

    def has_subscribers(self, topic: str) -> bool:
        """Return what the component saw."""
        return self._saw(self._ports[topic], "anything subscribes to")

    def _saw(self, port: str, asked: str) -> bool:
        seen = self._call.subscribed.get(port)
        if seen:
            return seen.popleft()
        self._note(f"asks more often whether {asked} {port}")
        return True

    def open_input(self, subscription: "_RerunSubscription") -> None:
        """Note the subscription of a port."""
        self._subscriptions[self._ports[subscription.topic]] = subscription

    def close_input(self, topic: str) -> None:
        """Forget the subscription of a port."""
        self._subscriptions.pop(self._ports[topic], None)

    def pending(self, subscription: "_RerunSubscription") -> tuple[Any, MessageId] | None:
        """Return what was taken from a port within another call; None if nothing was."""
        waiting = self._call.pending.get(self._ports[subscription.topic])
        if not waiting:
            return None
        identity = waiting.popleft()
        return self.message(subscription, identity), identity

    def publish(self, topic: str, cls: type[Any], message: Any) -> int:
        """Compare a message with the recorded one; return its number."""
        port = self._ports[topic]
        result = self.result.topics.setdefault(topic, TopicResult())
        self.published.append((topic, self.time_ns, message))
        expected = self._call.sent.get(port)
        if not expected and self._call.is_cut:
            return 1
        if not expected:
            result.extra += 1
            self._differ(topic, f"publishes one message more: {_shortened(message)}")
            return 1
        identity = expected.popleft()
        if identity.sequence == 0:  # nothing subscribed to it
            return 0
        recorded = self._messages.find(identity)
        if recorded is None:
            result.not_recorded += 1
            return identity.sequence
        result.compared += 1
        if recorded.data != self.codec.encode(message):
            result.different += 1
            self._differ(topic, self._difference(cls, recorded, message), recorded.sent_ns)
        return identity.sequence

    def outcome(self, method: str) -> Mapping[str, Any]:
        """Return what the children of a supervisor have answered to a method."""
        if not self._call.outcomes and self._call.is_cut:
            raise _Cut
        if not self._call.outcomes:
            raise CannotRerun(
                f"it calls `children.{method}` in {self._call.name}, unlike in the recording"
            )
        outcome: Mapping[str, Any] = json.loads(self._call.outcomes.popleft())
        if outcome.get("method") != method:
            raise CannotRerun(
                f"it calls `children.{method}` in {self._call.name}, in the recording "
                f"`{outcome.get('method')}`"
            )
        return outcome

    def _difference(self, cls: type[Any], recorded: Payload, message: Any) -> str:
        if recorded.type_hash and recorded.type_hash != type_hash(cls):
            return "the definition of its messages has changed since the recording"
        try:
            found = first_difference(
                self.codec.decode(cls, recorded.data),
                self.codec.decode(cls, self.codec.encode(message)),
            )
        except InvalidMessage as error:
            return f"the recorded message is invalid now: {error}"
        if found is None:
            return "the bytes of the message differ, but no field"
        return f"{found.path} is {found.rerun}, recorded was {found.recorded}"

    def _check_rest(self, environment: CallEnvironment) -> None:
        """Report what the recorded call did beyond that of the re-run."""
        end = self.ended  # first, because it is the cause of what is missing
        recorded_end = environment.end
        if end is not None and recorded_end is None and not environment.is_cut:
            self._differ("", f"the component ends, which the recorded one did not: {end.reason}")
        elif recorded_end is not None:
            reason = recorded_end["reason"]
            if end is None:
                self._differ("", f"the component does not end; the recorded one did: {reason}")
            elif end.normal != recorded_end["normal"] or end.reason != reason:
                self._differ("", f"the component ends: {end.reason}; recorded was: {reason}")
        topics = {port: topic for topic, port in self._ports.items()}
        for port, missing in environment.sent.items():
            sent = [one for one in missing if one.sequence]
            if sent and port in topics:
                topic = topics[port]
                self.result.topics.setdefault(topic, TopicResult()).missing += len(sent)
                recorded = self._messages.find(sent[0])
                time_ns = self.time_ns if recorded is None else recorded.sent_ns
                self._differ(topic, f"does not publish {_messages(len(sent))}", time_ns)
        services = {port: service for service, port in self._service_ports.items()}
        for port, unsent in environment.service_sent.items():
            if unsent and port in services:
                service = services[port]
                result = self.result.topics.setdefault(service, TopicResult())
                result.missing += len(unsent)
                self._differ(service, f"does not send {_messages(len(unsent))}")
        if environment.times:
            self._note(f"reads the clock less often in {environment.name}")

    def _differ(self, topic: str, what: str, time_ns: int | None = None) -> None:
        self.result.differences += 1
        if self.result.first is None:
            at = self.time_ns if time_ns is None else time_ns
            self.result.first = Difference(topic, at, self._call_ns, self._call.name, what)

    def _note(self, text: str) -> None:
        if len(self.result.notes) < _MOST_NOTES and text not in self.result.notes:
            self.result.notes.append(text)

    def _rejecting(self, call: Callable[[], object]) -> None:
        try:
            call()
        except CairnError as error:  # the component has rejected it, as it may have done before
            _log.debug("rejected: %s", error)

    def _on_end(self, report: ExitReport) -> None:
        self.ended = report


class _RerunScheduler:
    """Keeps what the component posts until the log says that it is called."""

    def __init__(self) -> None:
        self._posted: deque[Callable[[], None]] = deque()
        self.on_time: Callable[[], None] = lambda: None

    def post(self, call: Callable[[], None]) -> None:
        self._posted.append(call)

    def make_posted(self) -> bool:
        """Make the first posted call; return whether there was one."""
        if not self._posted:
            return False
        self._posted.popleft()()
        return True

    def deliver(self, call: Callable[[], None]) -> None:
        call()

    def receive(self, call: Callable[[], None]) -> None:
        call()

    def wake_at(self, time: int) -> None:
        """Do nothing: the log says when timers ran."""

    def bind(self, on_time: Callable[[], None]) -> None:
        self.on_time = on_time

    def stop(self) -> None:
        """Do nothing: the log ends."""


class _RerunBus:
    """The bus of the component."""

    def __init__(self, rerun: Rerun) -> None:
        self._rerun = rerun

    def node(self, name: str, report: Report, warn: Report | None = None) -> "_RerunNode":
        return _RerunNode(self._rerun)

    def wait_for_peers(self, timeout_s: float) -> list[str]:
        return []


class _RerunNode(Node):
    """The component on its bus."""

    def __init__(self, rerun: Rerun) -> None:
        super().__init__()
        self._rerun = rerun

    def _open_publisher(self, options: PublisherOptions) -> "_RerunPublisher | _NothingPublished":
        if options.shared:  # of every node, and not logged
            return _NothingPublished()
        return _RerunPublisher(self._rerun, options.topic, options.message)

    def _open_subscription(self, options: SubscriptionOptions) -> "_RerunSubscription":
        return _RerunSubscription(self._rerun, options)

    def _open_server(self, options: ServerOptions) -> "RerunServer | _NothingServed":
        if options.is_private:  # of every node, and not logged
            return _NothingServed()
        return RerunServer(self._rerun, options)

    def _open_client(self, options: ClientOptions) -> RerunClient:
        return RerunClient(self._rerun, options)

    def close(self) -> None:
        """Do nothing."""


class _NothingPublished:
    published = 0
    gid = bytes(16)
    has_subscribers = False

    def publish(self, message: Any) -> int:
        return 0

    def close(self) -> None:
        """Do nothing."""


class _NothingServed:
    received = invalid = refused = 0

    def take(self) -> None:
        return None

    def close(self) -> None:
        """Do nothing."""


class _RerunPublisher:
    def __init__(self, rerun: Rerun, topic: str, message: type[Any]) -> None:
        self.published = 0
        self.gid = bytes(16)
        self._rerun = rerun
        self._topic = topic
        self._message = message

    @property
    def has_subscribers(self) -> bool:
        return self._rerun.has_subscribers(self._topic)

    def publish(self, message: Any) -> int:
        self.published += 1
        return self._rerun.publish(self._topic, self._message, message)

    def close(self) -> None:
        """Do nothing."""


class _RerunSubscription:
    received = dropped = invalid = refused = 0

    def __init__(self, rerun: Rerun, options: SubscriptionOptions) -> None:
        self.topic = options.topic
        self.message = options.message
        self.taken: MessageId | None = None
        self._rerun = rerun
        self._wake = options.wake
        self._next: tuple[Any, MessageId] | None = None
        rerun.open_input(self)

    def deliver(self, message: Any, identity: MessageId) -> None:
        """Have the component take a message."""
        self._next = (message, identity)
        self._wake()

    def take(self) -> Any | None:
        taken, self._next = self._next or self._rerun.pending(self), None
        if taken is None:
            return None
        message, self.taken = taken
        return message

    def close(self) -> None:
        self._rerun.close_input(self.topic)


def _messages(count: int) -> str:
    return "a message" if count == 1 else f"{count} messages"


def _shortened(message: Any) -> str:
    text = repr(message)
    return text if len(text) <= 200 else f"{text[:200]}..."

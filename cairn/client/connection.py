"""A client's connection to the bus: what exists there, and raw samples."""

from __future__ import annotations

import itertools
import queue
import secrets
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sized
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Literal, TypeGuard, TypeVar, cast

import zenoh
from zenoh.ext import HistoryConfig, declare_advanced_subscriber

from cairn.bus import control, keys
from cairn.bus.caches import query_caches
from cairn.bus.codec import Codec
from cairn.bus.credentials import NO_CREDENTIALS, Credentials
from cairn.bus.endpoints import (
    default_domain,
    domains_hint,
    endpoint_for,
    is_loopback,
    socket_path,
)
from cairn.bus.graph import read_graph
from cairn.bus.session import close_session, is_connected, open_client
from cairn.errors import CairnError
from cairn.schemas.cairn_msgs import MACHINE_STATUS, ComponentStatus, MachineStatus
from cairn.schemas.message import InvalidMessage, type_name

STATUS_TOPIC = "component_status"

Found = TypeVar("Found", bound=Sized)

_CLOSE_LIMIT_S = 1.0  # a link closes in milliseconds, unless the router is busy or stopped
_MATCH_LIMIT_S = 2.0
_CACHE_LIMIT_S = 5.0  # for all caches together
_CACHE_PAUSE_S = 1.0  # caches that have sent nothing for so long do not answer

_STATUS_LIMIT_S = 1.0  # four times the period of statuses
_CACHES_FIRST_S = 0.3  # before the graph is read
_BUSY_LIMIT_S = 3.0
_GRAPH_LIMIT_S = 0.3  # a robot's is read in some ms
_LISTING_LIMIT_S = 10.0  # for all attempts to list the components
_STATUS_PAUSE_S = 0.5  # if no further component has answered for so long, the others do not
_STATUS_BYTES = 64 << 10  # a longer status is forged: one port takes about 100 bytes
_MAX_ROBOTS = 50  # whose statuses are read at once
_MAX_ANSWERED = 10_000  # components
_MAX_SILENT = 100  # components without an answer that are listed
KEPT_BYTES = 64 << 20
"""Samples that a client keeps until they are read [bytes]; a single one may be longer."""


@dataclass(frozen=True)
class Statuses:
    """The components on the bus.

    Attributes:
        answered: last status by full name.
        silent: announced, but without an answer, by full name: the process id in the session id,
            which may be forged; None if it is not a session of Cairn.
        left_out: number of further ones that are not listed, because they are too many.
        incomplete: the router was too busy to list all in time: more may run.
    """

    answered: dict[str, ComponentStatus]
    silent: dict[str, int | None]
    left_out: int
    incomplete: bool


class SampleQueue(queue.Queue[Any]):
    """A queue of samples that drops the oldest ones when they take more than `KEPT_BYTES`."""

    def __init__(self) -> None:
        super().__init__()
        self._bytes = 0

    def _put(self, item: Any) -> None:
        self._bytes += len(item.payload)
        while self.queue and self._bytes > KEPT_BYTES:
            self._get()
        self.queue.append(item)

    def _get(self) -> Any:
        item = self.queue.popleft()
        self._bytes -= len(item.payload)
        return item


@dataclass(frozen=True)
class Connection:
    """A Zenoh session of a client, in one ROS domain."""

    session: zenoh.Session
    domain: int
    endpoint: str
    """That of the deployment's router."""

    @property
    def is_local(self) -> bool:
        """Whether its router is on this computer: at a Unix socket or a loopback address."""
        return socket_path(self.endpoint) is not None or is_loopback(self.endpoint)

    @classmethod
    def open(cls, endpoint: str = "", domain: int | None = None) -> Connection:
        """Connect to the router of a deployment, by default this user's in the domain.

        The domain is by default that of `ROS_DOMAIN_ID`, else 0.

        A router on the network may ask for what the environment variables `CAIRN_USER`,
        `CAIRN_PASSWORD_FILE`, `CAIRN_TLS_CA`, `CAIRN_TLS_CERTIFICATE` and `CAIRN_TLS_KEY` name.
        Raises `CairnError` if no router answers.
        """
        domain = default_domain() if domain is None else domain
        endpoint = endpoint_for(endpoint, domain)
        local = socket_path(endpoint) is not None  # such a router refuses who presents a password
        credentials = NO_CREDENTIALS if local else Credentials.from_environment()
        return cls(open_client([endpoint], credentials), domain, endpoint)

    def close(self) -> None:
        """Close the session."""
        close_session(self.session, _CLOSE_LIMIT_S)

    def is_alive(self) -> bool:
        """Return whether the deployment's router still runs, if only stopped or busy.

        It does not ask zenoh (1.10) whether the session is closed: that waits for the session's
        lock without releasing the GIL, while a thread that delivers a reply to `read_graph` has the
        lock and waits for the GIL.
        """
        try:
            return is_connected(self.session, self.endpoint)
        except zenoh.ZError:  # the session is closed
            return False

    def graph(self, patience_s: float | None = None) -> list[keys.NodeEntity | keys.EndpointEntity]:
        """Return all nodes and endpoints that exist; after `patience_s` [s] those known by then."""
        pattern = keys.tokens_pattern(self.domain)
        return read_graph(self.session, pattern, patience_s=patience_s)

    def elsewhere(self) -> str:
        """Return the sentence about other domains on this router; empty if it has none.

        For errors and notes that nothing runs in this domain.
        """
        graph = read_graph(self.session, keys.nodes_pattern("*"), patience_s=_GRAPH_LIMIT_S)
        domains = {one.domain for one in graph if isinstance(one, keys.NodeEntity)}
        return domains_hint(sorted(domains - {self.domain}), "this router has nodes in")

    def nodes(self) -> list[str]:
        """Return the full names of the nodes that are of Cairn (`/robot/localizer`), sorted."""
        graph = read_graph(self.session, keys.nodes_pattern(self.domain))
        own = (one for one in graph if isinstance(one, keys.NodeEntity) and not one.is_foreign)
        return sorted({one.name for one in own})

    def endpoints(
        self, topic: str = "", kind: Literal["M$*", "S$*"] = "M$*"
    ) -> list[keys.EndpointEntity]:
        """Return the publishers and subscriptions of a topic (full name), or of all topics.

        `*` in the topic stands for any characters. With kind `S$*`, return the servers and clients
        of services instead.
        """
        graph = read_graph(self.session, keys.endpoints_pattern(self.domain, topic, kind))
        return [entity for entity in graph if isinstance(entity, keys.EndpointEntity)]

    def statuses(self) -> dict[str, ComponentStatus]:
        """Return the last status of every component that answers within 1 s, by full name."""
        return self.read_statuses(find_silent=False).answered

    def find(self, wanted: Callable[[Mapping[str, ComponentStatus]], Found]) -> Found:
        """Return what is `wanted` of the last statuses by full name; empty if none has it.

        While the router is too busy to list all components, that nothing is found does not say that
        it does not run: they are read again. Raises `CairnError` if that takes longer than 10 s.
        """
        deadline = time.monotonic() + _LISTING_LIMIT_S
        while True:
            read = self.read_statuses(find_silent=False)
            found = wanted(read.answered)
            if found or not read.incomplete:
                return found
            if time.monotonic() >= deadline:
                raise CairnError(
                    f"the components cannot be listed within {_LISTING_LIMIT_S:g} s: the computer "
                    "is too busy, or a program floods the bus; try again, or see `cairn graph`"
                )

    def read_statuses(self, *, find_silent: bool = True) -> Statuses:
        """Return the last status of every component, and which have not answered within 1 s.

        If the router is too busy to list them, it waits for up to 3 s for the first answer, and for
        0.5 s for each further one. Without `find_silent`, it does not read the graph, which
        may be crowded, once all that keep a status have sent it.
        """
        codec = Codec()
        samples = SampleQueue()
        answered: dict[str, ComponentStatus] = {}
        answered_at = time.monotonic()
        with ExitStack() as stack:
            # Of all robots, and whatever the graph contains: reading that may take too long, and
            # what is sent after it arrives after it.
            everywhere = keys.message_key(self.domain, f"/*/{STATUS_TOPIC}", ComponentStatus)
            stack.enter_context(self.listen(everywhere, samples=samples))
            have_all_replied = self._ask_caches(everywhere, samples).wait(_CACHES_FIRST_S)
            graph: list[keys.NodeEntity | keys.EndpointEntity] = []
            asked_at = time.monotonic()
            if find_silent or not have_all_replied or samples.empty():
                pattern = keys.endpoints_pattern(self.domain, f"*/{STATUS_TOPIC}", "MP")
                graph = read_graph(self.session, pattern, patience_s=_GRAPH_LIMIT_S)
            is_busy = time.monotonic() - asked_at >= _GRAPH_LIMIT_S
            limit = answered_at + (_BUSY_LIMIT_S if is_busy else _STATUS_LIMIT_S)
            announced = [one for one in graph if _is_status_publisher(one)]
            # Tokens may be forged: those of processes that exist here come first.
            announced.sort(key=lambda one: (not _runs_here(one.node.zid), one.topic, one.node.name))
            topics = list(dict.fromkeys(one.topic for one in announced))[:_MAX_ROBOTS]
            publishers = {
                keys.gid(keys.token_key(one)): one for one in announced if one.topic in topics
            }
            for topic in topics:  # over the network, a role may allow only these
                key = keys.message_key(self.domain, topic, ComponentStatus)
                stack.enter_context(self.listen(key, latched=True, samples=samples))
            missing = dict(publishers)
            deadline = limit
            while missing or is_busy or not samples.empty():
                if time.monotonic() > limit + _STATUS_PAUSE_S:
                    break
                if answered:
                    deadline = min(limit, answered_at + _STATUS_PAUSE_S)
                try:
                    sample = samples.get(timeout=max(0.0, deadline - time.monotonic()))
                except queue.Empty:
                    break
                sent = keys.Attachment.of(sample)
                if sent is None or len(sample.payload) > _STATUS_BYTES:
                    continue  # a foreign publisher without rmw_zenoh's numbering
                with suppress(InvalidMessage):  # components count these at their ports
                    status = codec.decode(ComponentStatus, sample.payload.to_bytes())
                    known = publishers.get(sent.gid)
                    robot = str(sample.key_expr).split("/")[1]
                    name = known.node.name if known else f"/{robot}/{status.component}"
                    if missing.pop(sent.gid, None) is not None or name not in answered:
                        answered_at = time.monotonic()
                    if len(answered) < _MAX_ANSWERED:
                        answered[name] = status
        silent = {
            one.node.name: keys.process_id(one.node.zid)
            for one in missing.values()
            if one.node.name not in answered
        }
        listed = dict(itertools.islice(silent.items(), _MAX_SILENT))
        left_out = len(silent) - len(listed) + len(announced) - len(publishers)
        return Statuses(answered, listed, left_out, is_busy)

    def machine_statuses(self) -> dict[str, list[MachineStatus]]:
        """Return what each machine that can be reached has published last, by robot."""
        codec = Codec()
        found: dict[str, list[MachineStatus]] = {}
        everywhere = keys.message_key(self.domain, f"/*/*/{MACHINE_STATUS}", MachineStatus)
        for sample in self.cached(everywhere)[0]:
            if len(sample.payload) <= _STATUS_BYTES:
                with suppress(InvalidMessage):
                    status = codec.decode(MachineStatus, sample.payload.to_bytes())
                    _, robot, root, *_ = str(sample.key_expr).split("/")
                    # Each is below its root's name, on which no other machine may publish.
                    if root in ("root", f"root_{status.machine}"):
                        found.setdefault(robot, []).append(status)
        return found

    def router_process(self) -> int | None:
        """Return the process id of the router on this computer; None if it is on another one."""
        if not self.is_local:
            return None
        return next((keys.process_id(str(zid)) for zid in self.session.info.routers_zid()), None)

    def request(
        self,
        component: str,
        verb: str,
        arguments: Mapping[str, Any] | None = None,
        *,
        timeout_s: float,
    ) -> Any:
        """Send a control request to a component (full name) and return its reply.

        Raises `ControlError` if the component rejects it, `NoReplyError` if it does not reply.
        """
        return control.request(
            self.session, self.domain, component, verb, arguments, timeout_s=timeout_s
        )

    def cached(self, key: str) -> tuple[list[zenoh.Sample], bool]:
        """Return the samples that the latched publishers of a key keep, and whether these are all.

        They are not if a cache has not replied, or if there are more than `KEPT_BYTES`. This asks
        the caches as an advanced subscriber does, but it knows when all have replied. It waits for
        those that do not reply until nothing has arrived for 1 s.
        """
        replies: queue.Queue[zenoh.Reply | None] = queue.Queue()
        query_caches(self.session, key, replies.put, lambda: replies.put(None), _CACHE_LIMIT_S)
        samples: list[zenoh.Sample] = []
        size, complete = 0, True
        while True:
            try:
                reply = replies.get(timeout=_CACHE_PAUSE_S)
            except queue.Empty:
                return samples, False
            if reply is None:
                return samples, complete
            if reply.ok is None:
                complete = False
                continue
            size += len(reply.ok.payload)
            if size > KEPT_BYTES:
                return samples, False
            samples.append(reply.ok)

    def _ask_caches(self, key: str, samples: SampleQueue) -> threading.Event:
        """Add the samples that the latched publishers of a key keep, each when it arrives.

        Returns an event that is set when all have replied, or after 1 s.
        """

        def add(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                samples.put(reply.ok)

        ended = threading.Event()
        query_caches(self.session, key, add, ended.set, _STATUS_LIMIT_S)
        return ended

    def publisher(self, key: str, encoding: zenoh.Encoding) -> zenoh.Publisher:
        """Declare a publisher, and wait until it reaches a subscriber.

        Raises `CairnError` if it does not within 2 s: a router on the network does not announce
        subscribers to users who may not publish to them.
        """
        publisher = self.session.declare_publisher(
            key, encoding=encoding, congestion_control=zenoh.CongestionControl.BLOCK
        )
        changed = threading.Event()
        callback: Any = zenoh.handlers.Callback(lambda _: changed.set(), indirect=False)
        listener = publisher.declare_matching_listener(callback)
        deadline = time.monotonic() + _MATCH_LIMIT_S
        try:
            # zenoh's stub says that the status is a bool, but it is an object, which is always true
            while not (matching := cast("Any", publisher.matching_status).matching):
                if not changed.wait(max(0.0, deadline - time.monotonic())):
                    break
                changed.clear()
        finally:
            listener.undeclare()
        if not matching:
            publisher.undeclare()
            topic = key.partition("/")[2].rsplit("/", 2)[0]  # without domain, type and hash
            raise CairnError(
                f"/{topic}: no subscriber can be reached: the component has just ended, or, over "
                "the network, your role does not allow publishing on this topic"
            )
        return publisher

    @contextmanager
    def listen(
        self, key: str, *, latched: bool = False, samples: SampleQueue | None = None
    ) -> Iterator[SampleQueue]:
        """Yield a queue of all samples on a key from now on; with the latched ones if asked.

        The latched ones may arrive after newer ones. `samples` is the queue, by default a new one.
        """
        samples = SampleQueue() if samples is None else samples
        handler = zenoh.handlers.Callback(samples.put, indirect=False)
        subscriber = self.subscriber(key, handler, latched=False)
        try:
            if latched:
                # Not an advanced subscriber: that delivers nothing until all caches have replied,
                # and one process that is stopped does not.
                self._ask_caches(key, samples)
            yield samples
        finally:
            subscriber.undeclare()

    def subscriber(self, key: str, handler: Any, *, latched: bool) -> Any:
        """Declare a Zenoh subscriber."""
        if not latched:
            return self.session.declare_subscriber(key, handler)
        history = HistoryConfig(detect_late_publishers=True)
        return declare_advanced_subscriber(self.session, key, handler, history=history)


class Publishers:
    """The publishers of a client, declared when they are first needed; from any thread."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._gid = secrets.token_bytes(16)
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._sent: Counter[str] = Counter()
        self._lock = threading.Lock()  # messages have numbers in the order of publication

    def reaches_subscriber(self, key: str) -> bool:
        """Return whether something subscribes to a key that was published on before."""
        known = self._publishers.get(key)
        # zenoh's stub says that the status is a bool, but it is an object, which is always true
        return known is not None and cast("Any", known.matching_status).matching

    def put(self, key: str, ros_type: str, payload: bytes) -> None:
        """Publish CDR of a message type on a key.

        Raises `CairnError` if it reaches no subscriber within 2 s, `zenoh.ZError` if the session is
        closed.
        """
        with self._lock:
            if key not in self._publishers:
                encoding = zenoh.Encoding.APPLICATION_CDR.with_schema(ros_type)
                self._publishers[key] = self._connection.publisher(key, encoding)
            self._sent[key] += 1
            sent = keys.Attachment(self._sent[key], time.time_ns(), self._gid)
            self._publishers[key].put(payload, attachment=sent.encode())


def _is_status_publisher(
    one: keys.NodeEntity | keys.EndpointEntity,
) -> TypeGuard[keys.EndpointEntity]:
    return (
        isinstance(one, keys.EndpointEntity)
        and one.kind == "MP"
        and one.type_name == type_name(ComponentStatus)
    )


def _runs_here(zid: str) -> bool:
    """Return whether a session id names a process that exists on this machine."""
    pid = keys.process_id(zid)
    return pid is not None and Path(f"/proc/{pid}").exists()


def check_robot(robot: str, known: Iterable[str]) -> None:
    """Raise `CairnError` if `robot` is given and not among the known robots."""
    robots = sorted(set(known))
    if robot and robot not in robots:
        listed = ", ".join(robots) or "none"
        raise CairnError(f"there is no robot {robot} on the bus; there are: {listed}")


def resolve(names: Iterable[str], name: str, robot: str) -> str:
    """Return the one full name among `names` that `name` means.

    Raises `CairnError` if there is none, or if several robots have it and `robot` is empty.
    """
    names = sorted(set(names))
    if name.startswith("/"):
        matches = [full for full in names if full == name]
    else:
        matches = [
            full
            for full in names
            if full == f"/{robot}/{name}" or (not robot and full.split("/", 2)[2:] == [name])
        ]
    if len(matches) == 1:
        return matches[0]
    if matches:
        several = ", ".join(matches)
        raise CairnError(f"{name}: several robots have it: {several}; give --robot (robot=...)")
    shorts = {full: full if name.startswith("/") else full.split("/", 2)[-1] for full in names}
    close = [
        full for full in names if shorts[full] in get_close_matches(name, shorts.values(), n=2)
    ]
    guess = f"did you mean {' or '.join(close)}? There" if close else "there"
    listed = ", ".join(names) or "none"
    where = f" of robot {robot}" if robot else ""
    raise CairnError(f"there is no {name}{where} on the bus; {guess} are: {listed}")

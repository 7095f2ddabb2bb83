"""How commands reach a running deployment: options, session, and what is read from the bus."""

import queue
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Annotated, Any

import typer
import zenoh
from zenoh.ext import HistoryConfig, declare_advanced_subscriber

from cairn.bus import keys
from cairn.bus.codec import Codec
from cairn.bus.graph import read_graph
from cairn.bus.session import open_client
from cairn.deployment.model import is_loopback
from cairn.errors import CairnError
from cairn.schemas.cairn_msgs import ComponentStatus
from cairn.schemas.message import InvalidMessage, type_name

Connect = Annotated[
    str,
    typer.Option(
        envvar="CAIRN_CONNECT", help="Endpoint of the deployment's router.", metavar="ENDPOINT"
    ),
]
Domain = Annotated[
    int, typer.Option(envvar="ROS_DOMAIN_ID", min=0, max=232, help="Domain of the deployment.")
]
Robot = Annotated[
    str, typer.Option(help="The robot meant, where several share the bus.", metavar="NAME")
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON.")]

DEFAULT_CONNECT = "tcp/127.0.0.1:7447"
STATUS_TOPIC = "component_status"

_LIMIT_S = 5.0  # who has not answered by then hangs


@dataclass(frozen=True)
class Connection:
    """A command's place on the bus."""

    session: zenoh.Session
    domain: int

    def graph(self) -> list[keys.NodeEntity | keys.EndpointEntity]:
        """All nodes and endpoints alive."""
        return read_graph(self.session, self.domain)

    def endpoints(self) -> list[keys.EndpointEntity]:
        """All publishers and subscriptions alive."""
        return [entity for entity in self.graph() if isinstance(entity, keys.EndpointEntity)]

    def statuses(self) -> dict[str, ComponentStatus]:
        """The last status of every component that answers, by full name (`/robot/localizer`)."""
        codec = Codec()
        wanted = type_name(ComponentStatus)
        writers = {
            keys.gid(keys.token_key(endpoint)): endpoint
            for endpoint in self.endpoints()
            if endpoint.kind == "MP" and endpoint.type_name == wanted
        }
        found: dict[str, ComponentStatus] = {}
        deadline = time.monotonic() + _LIMIT_S
        for topic in sorted({endpoint.topic for endpoint in writers.values()}):
            key = keys.message_key(self.domain, topic, ComponentStatus, codec)
            expected = {gid for gid, endpoint in writers.items() if endpoint.topic == topic}
            with self.listen(key, latched=True) as samples:
                while expected:
                    try:
                        sample = samples.get(timeout=max(0.0, deadline - time.monotonic()))
                    except queue.Empty:
                        break
                    sent = attachment_of(sample)
                    if sent is None or sent.gid not in expected:
                        continue  # a foreign writer without rmw_zenoh's numbering
                    expected.discard(sent.gid)
                    with suppress(InvalidMessage):  # components count these at their ports
                        status = codec.decode(ComponentStatus, sample.payload.to_bytes())
                        found[writers[sent.gid].node.name] = status
        return found

    def kept(self, key: str) -> tuple[list[zenoh.Sample], bool]:
        """What the latched writers on a key expression keep, and whether all answered within 5 s.

        Their caches are asked as an advanced subscriber asks them, but here it is known when all
        have answered.
        """
        replies = self.session.get(
            keys.cached_samples_key(key),
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            accept_replies=zenoh.ReplyKeyExpr.ANY,  # they stand under the writer's key
            timeout=_LIMIT_S,
        )
        samples, complete = [], True
        for reply in replies:
            if reply.ok is None:
                complete = False
            else:
                samples.append(reply.ok)
        return samples, complete

    @contextmanager
    def listen(self, key: str, *, latched: bool = False) -> Iterator["queue.Queue[Any]"]:
        """All samples on a key expression from now on, with the latched ones if asked."""
        samples: queue.Queue[Any] = queue.Queue()
        handler = zenoh.handlers.Callback(samples.put, indirect=False)
        subscriber: Any
        if latched:
            subscriber = declare_advanced_subscriber(
                self.session, key, handler, history=HistoryConfig(detect_late_publishers=True)
            )
        else:
            subscriber = self.session.declare_subscriber(key, handler)
        try:
            yield samples
        finally:
            subscriber.undeclare()


def attachment_of(sample: Any) -> keys.Attachment | None:
    """Number, time and writer of a sample, None if a foreign writer has not given them."""
    if sample.attachment is None:
        return None
    try:
        return keys.Attachment.decode(sample.attachment.to_bytes())
    except keys.WireFormatError:
        return None


@contextmanager
def connected(connect: str, domain: int) -> Iterator[Connection]:
    """Join the bus for the time of a command; `CairnError` if no deployment answers."""
    try:
        is_loopback(connect)
    except ValueError as error:
        raise CairnError(f"--connect: {error}") from error
    session = open_client([connect])
    try:
        yield Connection(session, domain)
    finally:
        session.close()


def check_robot(robot: str, known: Iterable[str]) -> None:
    """Raise `CairnError` if a robot is asked for that is not among those known, if any is."""
    robots = sorted(set(known))
    if robot and robot not in robots:
        listed = ", ".join(robots) or "none"
        raise CairnError(f"there is no robot {robot} on the bus; there are: {listed}")


def resolve(names: list[str], name: str, robot: str) -> str:
    """The full name of the component (or topic) meant by `name`, among those that exist.

    Raises `CairnError` if there is none, or if several robots have it and `robot` is not given.
    """
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
        several = ", ".join(sorted(matches))
        raise CairnError(f"{name}: several robots have it: {several}; give --robot")
    listed = ", ".join(sorted(names)) or "none"
    where = f" of robot {robot}" if robot else ""
    raise CairnError(f"there is no {name}{where} on the bus; there are: {listed}")

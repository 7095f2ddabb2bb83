"""What the console shows of components and topics, from the statuses that components publish."""

from __future__ import annotations

import struct
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, Generic, TypeVar

import psutil

from cairn.bus.codec import Codec
from cairn.client.machines import components_of_lost, described_links, machine_of_router
from cairn.console.browser import Browser, BrowserSubscription
from cairn.console.protocol import SubscribeRequest
from cairn.console.source import Channel, ConnectionGraph, Message
from cairn.schemas.builtin_interfaces import to_ns
from cairn.schemas.cairn_msgs import ComponentStatus, MachineStatus, PortStatus
from cairn.schemas.message import InvalidMessage, type_name
from cairn.schemas.std_msgs import Header
from cairn.system.clock import SECOND

if TYPE_CHECKING:
    from cairn.console.hub import Hub

S = TypeVar("S", ComponentStatus, MachineStatus)

_STATUS_TYPE: Final = type_name(ComponentStatus)
_MACHINE_TYPE: Final = type_name(MachineStatus)
_MOST_MACHINES: Final = 100  # of all robots, likewise
_MOST_COMPONENTS: Final = 1000  # of all robots; further ones, of forged statuses, are not shown
_LONGEST_STATUS: Final = 64 << 10  # one port takes about 100 bytes
_SILENT_NS: Final = 3 * SECOND  # statuses arrive four times a second
_LOST_NS: Final = SECOND  # so long a component is silent that another machine has lost
_MAX_FOREIGN: Final = 20  # names of one topic that pages get
_LENGTH: Final = struct.Struct("<I")
_STAMP_END: Final = 12  # of the header, after 4 bytes of encapsulation


@dataclass
class _Counter:
    """The count of messages of one port, and what follows from its changes."""

    messages: int = 0
    counted_at: int | None = None  # stamp of the status [ns]
    changed_at: int | None = None
    rate_hz: float | None = None

    def update(self, messages: int, stamp: int) -> None:
        """Take the count of a status with that stamp [ns]."""
        before, at = self.messages, self.counted_at
        if at == stamp:
            return
        self.messages, self.counted_at = messages, stamp
        if at is None or stamp < at:  # the first one, or time was set back
            self.rate_hz = self.changed_at = None
            return
        new = messages - before if messages >= before else messages  # it was configured again
        self.rate_hz = new * SECOND / (stamp - at)
        if new:
            self.changed_at = stamp


@dataclass
class _Kept(Generic[S]):
    """The last status of a component or a machine; `payload` is a newer one, not decoded yet.

    `counters` are those of a component's ports, by port and direction.
    """

    payload: bytes | None
    received_ns: int
    status: S | None = None
    counters: defaultdict[tuple[str, int], _Counter] = field(
        default_factory=lambda: defaultdict(_Counter)
    )


class _Statuses(dict[tuple[str, str], _Kept[S]]):
    """The newest statuses of one class, by robot and sender; of at most `most` senders."""

    def __init__(self, message: type[S], most: int) -> None:
        super().__init__()
        self._message: type[S] = message
        self._most = most

    def receive(self, robot: str, payload: bytes, now: int) -> None:
        """Keep a status; it is decoded only when it is shown."""
        name = _sender(payload)
        if name is None or len(payload) > _LONGEST_STATUS:
            return
        known = self.get((robot, name))
        if known is not None:
            known.payload, known.received_ns = payload, now
        elif len(self) < self._most:
            self[robot, name] = _Kept(payload, now)

    def decode(self, codec: Codec) -> Iterator[tuple[_Kept[S], S]]:
        """Decode what has arrived, and yield it."""
        for key, one in list(self.items()):
            payload, one.payload = one.payload, None
            if payload is None:
                continue
            try:
                one.status = codec.decode(self._message, payload)
            except InvalidMessage:
                del self[key]  # forged, or of another version
                continue
            yield one, one.status


class StatusMonitor:
    """Keeps the newest status of each component and machine, and describes them and topics by it.

    `arrival` returns the time [ns] at which a message arrives.
    """

    def __init__(self, arrival: Callable[[Message], int]) -> None:
        self._arrival = arrival
        self._codec = Codec()
        self._components = _Statuses(ComponentStatus, _MOST_COMPONENTS)
        self._machines = _Statuses(MachineStatus, _MOST_MACHINES)
        self._own: dict[str, str | None] = {}  # machine on this computer, by robot of several
        self._awaited: dict[tuple[str, str], int] = {}  # announced without a status, since when

    def clear(self) -> None:
        """Forget everything: the link was lost, or a recording was moved to another time."""
        self._components.clear()
        self._machines.clear()
        self._own.clear()
        self._awaited.clear()

    def receive(self, robot: str, message: Message) -> None:
        """Keep a status of a component."""
        self._components.receive(robot, message.payload, self._arrival(message))

    def receive_machine(self, robot: str, message: Message) -> None:
        """Keep a status of a machine."""
        self._machines.receive(robot, message.payload, self._arrival(message))

    def update(self, router: int | None = None) -> None:
        """Decode what has arrived, and count; `router` is the process id of the one here."""
        for one, status in self._components.decode(self._codec):
            stamp = to_ns(status.header.stamp)
            for port in status.ports:
                one.counters[port.port, port.direction].update(port.messages, stamp)
        for _ in self._machines.decode(self._codec):
            pass
        self._own = {}
        for robot in {robot for robot, _ in self._machines}:
            found = [one.status for (name, _), one in self._components.items() if name == robot]
            self._own[robot] = machine_of_router(filter(None, found), router)

    def pids(self) -> list[int]:
        """Return the process ids of the components that may run on this computer."""
        found = {
            one.status.pid
            for (robot, _), one in self._components.items()
            if one.status is not None and self._may_run_here(robot, one.status)
        }
        return sorted(found - {0})

    def machines(self, robot: str, now: int) -> list[dict[str, Any]]:
        """Return how the machines of a robot that can be reached see each other."""
        for key, one in list(self._machines.items()):  # a forged one makes room as well
            if key[0] == robot and now - one.received_ns > _SILENT_NS:
                del self._machines[key]
        return described_links(self._machine_statuses(robot, now))

    def _machine_statuses(self, robot: str, now: int) -> list[MachineStatus]:
        return [
            one.status
            for (of_robot, _), one in self._machines.items()
            if of_robot == robot and one.status is not None and now - one.received_ns <= _SILENT_NS
        ]

    def _may_run_here(self, robot: str, status: ComponentStatus) -> bool:
        """Return whether a component's process may be on this computer.

        For a robot of one machine, its process has to show that: see `ProcessMonitor`.
        """
        return not status.machine or status.machine == self._own.get(robot)

    def components(
        self, robot: str, graph: ConnectionGraph, loads: Mapping[int, ProcessLoad], now: int
    ) -> list[dict[str, Any]]:
        """Return the components of a robot, those that are not loaded included.

        Siblings are in the order of the deployment.

        Args:
            robot: its name.
            graph: who publishes what; a component that publishes its status exists.
            loads: of the processes on this computer, by id.
            now: time [ns] on the clock of `arrival`.
        """
        topic = f"/{robot}/component_status"
        alive = {node.rpartition("/")[2] for node in graph.publishers.get(topic, ())}
        lost = components_of_lost(self._machine_statuses(robot, now))
        rows: dict[str, dict[str, Any]] = {}
        parents: dict[str, str] = {}
        known = {
            name: (one, one.status)
            for (of_robot, name), one in self._components.items()
            if of_robot == robot and one.status is not None
        }
        # A component that a root starts for a parent on another machine is a child of both: that
        # parent comes later.
        for name, (one, status) in sorted(known.items(), key=lambda item: item[1][1].parent != ""):
            silent_ns = now - one.received_ns
            if name in lost and silent_ns > _LOST_NS:
                state = "lost"
            elif status.state == "finalized" or (silent_ns > _SILENT_NS and name not in alive):
                state = "not loaded"
            else:
                state = "no answer" if silent_ns > _SILENT_NS else str(status.state)
            is_measured = state != "not loaded" and self._may_run_here(robot, status)
            rows[name] = _row(status, state, loads.get(status.pid) if is_measured else None)
            if state != "not loaded":
                for child in status.children:
                    parents.pop(child, None)
                    parents[child] = name
        for name, row in list(rows.items()):
            if row["state"] == "not loaded" and name not in parents:
                del rows[name]  # its supervisor is gone as well
                del self._components[robot, name]
        awaited = {}
        for name in dict.fromkeys([*parents, *sorted(alive), *lost]):
            if name in rows:
                continue
            parent = parents.get(name, "")
            since = now
            if name in alive:  # its first status may be on its way
                since = awaited[robot, name] = self._awaited.get((robot, name), now)
            if name in lost and name not in alive:
                rows[name] = _empty_row(name, parent, "lost", lost[name])
            elif now - since > _SILENT_NS:
                rows[name] = _empty_row(name, parent, "no answer")
            elif name in parents:
                rows[name] = _empty_row(name, parent, "not loaded")
        others = {key: since for key, since in self._awaited.items() if key[0] != robot}
        self._awaited = others | awaited
        # As in the deployment; statuses arrive in any order.
        order = {name: number for number, name in enumerate(parents)}
        order |= {name: -1 for name in known if name not in order}
        last = len(order)
        return sorted(rows.values(), key=lambda row: (order.get(row["name"], last), row["name"]))

    def topics(self, channels: Iterable[Channel], graph: ConnectionGraph) -> list[dict[str, Any]]:
        """Return all topics with their rates [Hz] and ages [s], None where no port counts them."""
        ports: defaultdict[str, list[tuple[PortStatus, _Counter]]] = defaultdict(list)
        now = 0
        for one in self._components.values():
            if one.status is None:
                continue
            now = max(now, to_ns(one.status.header.stamp))
            for port in one.status.ports:
                counter = one.counters[port.port, port.direction]
                ports[port.topic].append((port, counter))
        types = {channel.topic: channel.type_name for channel in channels}
        rows: list[dict[str, Any]] = []
        for topic in sorted({*types, *graph.publishers, *graph.subscribers}):
            sent = [counter for port, counter in ports[topic] if port.direction == port.OUT]
            taken = [counter for port, counter in ports[topic] if port.direction == port.IN]
            rates = [
                sum(rates) if is_sum else max(rates)
                for counters, is_sum in ((sent, True), (taken, False))
                if (rates := [one.rate_hz for one in counters if one.rate_hz is not None])
            ]
            changed = [one.changed_at for one in (*sent, *taken) if one.changed_at is not None]
            publishers = graph.publishers.get(topic, frozenset())
            subscribers = graph.subscribers.get(topic, frozenset())
            rows.append(
                {
                    "topic": topic,
                    "type": types.get(topic, ""),
                    "publishers": len(publishers),
                    "subscribers": len(subscribers),
                    "foreign_publishers": sorted(publishers & graph.foreign)[:_MAX_FOREIGN],
                    "foreign_subscribers": sorted(subscribers & graph.foreign)[:_MAX_FOREIGN],
                    "rate_hz": round(max(rates), 2) if rates else None,
                    "age_s": round(max(0, now - max(changed)) / SECOND, 2) if changed else None,
                }
            )
        return rows


@dataclass(frozen=True)
class ProcessLoad:
    """What a process takes: share of one core [%], None before it is known; memory [bytes]."""

    cpu_percent: float | None
    memory_bytes: int | None


class StatusReader(Browser):
    """Subscribes to the statuses of all robots, like a browser, and passes them to a monitor."""

    def __init__(self, monitor: StatusMonitor) -> None:
        super().__init__(0, "", "watch", _send_nothing)
        self._monitor = monitor
        self._last_id = 0

    def follow(self, hub: Hub, *, is_wanted: bool) -> None:
        """Subscribe to the statuses of new robots, or end all if no page is open."""
        if not is_wanted:
            for subscription in list(self.subscriptions.values()):
                hub.unsubscribe(self, subscription.id)
            self._monitor.clear()
            return
        known = {one.channel.id for one in self.subscriptions.values()}
        for channel in hub.channels.values():
            is_status = channel.type_name in (_STATUS_TYPE, _MACHINE_TYPE)
            if is_status and channel.id not in known:
                self._last_id += 1
                hub.subscribe(self, SubscribeRequest(id=self._last_id, channel_id=channel.id))

    def offer(self, subscription: BrowserSubscription, message: Message) -> None:
        """Pass a status on."""
        channel = subscription.channel
        if channel.type_name == _MACHINE_TYPE:
            self._monitor.receive_machine(channel.robot, message)
        else:
            self._monitor.receive(channel.robot, message)


async def _send_nothing(_: str | bytes) -> None:
    """Do nothing: the messages are not sent to a browser."""


class StateEvents:
    """Sends the events `components`, `machines` and `topics` to the consoles of a hub."""

    def __init__(self, hub: Hub, arrival: Callable[[Message], int]) -> None:
        """`arrival` returns the time [ns] at which a message arrives."""
        self._hub = hub
        self._monitor = StatusMonitor(arrival)
        self._reader = StatusReader(self._monitor)
        self._last: dict[str, tuple[str, Any]] = {}  # by key

    def clear(self) -> None:
        """Forget all statuses: a recording continues at another time."""
        self._monitor.clear()

    def update(self, router: int | None = None) -> list[int]:
        """Take what has arrived since; return the process ids of the components.

        `router` is the process id of the router, if it is on this computer. If no console is
        connected, nothing is subscribed.
        """
        self._reader.follow(self._hub, is_wanted=self._is_wanted)
        self._monitor.update(router)
        return self._monitor.pids()

    def send(self, loads: Mapping[int, ProcessLoad], now: int) -> None:
        """Send the events; `now` is on the clock of `arrival` [ns]."""
        hub, before = self._hub, self._last
        self._last = {}
        if not self._is_wanted:
            return
        # A recording has no graph of one time: there, a component exists while it sends statuses.
        graph = hub.graph if hub.source.mode == "live" else ConnectionGraph({}, {})
        for robot in hub.robots:
            rows = self._monitor.components(robot, graph, loads, now)
            value = {"robot": robot, "components": rows}
            self._last[f"components {robot}"] = ("components", value)
            links = {"robot": robot, "machines": self._monitor.machines(robot, now)}
            self._last[f"machines {robot}"] = ("machines", links)
        topics = self._monitor.topics(hub.channels.values(), hub.graph)
        self._last["topics"] = ("topics", topics)
        for key, (name, value) in self._last.items():
            if before.get(key) != (name, value):
                hub.broadcast(name, value, key=key)

    @property
    def _is_wanted(self) -> bool:
        return any(browser.is_console for browser in self._hub.browsers)

    def send_last(self, browser: Browser) -> None:
        """Send a new browser the last events."""
        for key, (name, value) in self._last.items():
            self._hub.send_event(browser, name, value, key=key)


class ProcessMonitor:
    """Measures the processes on this computer; for one thread at a time."""

    def __init__(self) -> None:
        self._processes: dict[int, psutil.Process] = {}
        self._memory: dict[int, int] = {}
        self._next = 0

    def loads(self, pids: Iterable[int]) -> dict[int, ProcessLoad]:
        """Return the loads of those processes that exist here and are of Cairn.

        The share of a core is that since the last call. Of the memory (PSS), which takes the kernel
        milliseconds to sum up, that of one process is read in each call, and that of new ones.
        """
        wanted = set(pids)
        for pid in self._processes.keys() - wanted:
            del self._processes[pid]
            self._memory.pop(pid, None)
        found = {}
        turn = sorted(self._processes)
        self._next = (self._next + 1) % max(1, len(turn))
        refreshed = turn[self._next] if turn else 0
        for pid in sorted(wanted):
            with suppress(psutil.Error, OSError):
                process = self._processes.get(pid)
                is_new = process is None or not process.is_running()
                if process is None or is_new:
                    process = psutil.Process(pid)
                    if "cairn" not in " ".join(process.cmdline()[:2]):
                        continue  # the component runs on another computer
                    self._processes[pid] = process
                    process.cpu_percent()
                if is_new or pid == refreshed:
                    self._memory[pid] = process.memory_full_info().pss
                cpu = None if is_new else process.cpu_percent()
                found[pid] = ProcessLoad(cpu, self._memory.get(pid))
        return found


def _sender(payload: bytes) -> str | None:
    """Return the component or machine in a status (CDR), its first text; None if there is none.

    The rest is not decoded.
    """
    if payload[:2] != b"\0\1":  # little endian, as all components write
        return None
    at = _STAMP_END
    try:
        (length,) = _LENGTH.unpack_from(payload, at)  # of frame_id
        at += _LENGTH.size + length
        at += -at % 4
        (length,) = _LENGTH.unpack_from(payload, at)
        at += _LENGTH.size
        return bytes(payload[at : at + length - 1]).decode() if 1 < length <= 1000 else None
    except (struct.error, UnicodeDecodeError):
        return None


def _row(status: ComponentStatus, state: str, load: ProcessLoad | None) -> dict[str, Any]:
    inputs = [port for port in status.ports if port.direction == port.IN]
    return {
        "name": status.component,
        "parent": status.parent,
        "machine": status.machine,
        "plugin": status.plugin,
        "placement": status.placement,
        "state": state,
        "pid": status.pid if state != "not loaded" else None,
        "restarts": status.restarts,
        "reason": status.reason,
        "handler": status.handler,
        "handler_s": round(status.handler_s, 2),
        "cpu_percent": load.cpu_percent if load is not None else None,
        "memory_bytes": load.memory_bytes if load is not None else None,
        "drops": sum(port.dropped for port in inputs),
        "invalid": sum(port.invalid for port in inputs),
        "refused": sum(port.refused for port in inputs),
        "ports": [
            {
                "port": port.port,
                "topic": port.topic,
                "direction": "in" if port.direction == port.IN else "out",
                "messages": port.messages,
                "dropped": port.dropped,
                "invalid": port.invalid,
                "refused": port.refused,
            }
            for port in status.ports
        ],
    }


def _empty_row(name: str, parent: str, state: str, machine: str = "") -> dict[str, Any]:
    """Return the row of a component without a status."""
    status = ComponentStatus(header=Header(), component=name, parent=parent, machine=machine)
    return {**_row(status, state, None), "pid": None}

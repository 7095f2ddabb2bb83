"""A program with the identity of a machine of the robot, which attacks the first machine.

`python -m tests.attack.hostile_machine ATTACK ENDPOINT IDENTITY` is linked to the router there, as
that of its machine is. It prints what it has sent, and ends when its standard input closes.
"""

from __future__ import annotations

import itertools
import json
import secrets
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import zenoh

from cairn.bus import keys
from cairn.bus.codec import Codec
from cairn.bus.keys import Attachment, EndpointEntity, NodeEntity
from cairn.bus.qos import RELIABLE
from cairn.bus.type_hash import type_hash
from cairn.schemas.builtin_interfaces import from_ns
from cairn.schemas.cairn_msgs import (
    ComponentStatus,
    MachineChild,
    MachineLink,
    MachineStatus,
    RecognizedObjectArray,
)
from cairn.schemas.cairn_nav_msgs import LocalizationEstimate
from cairn.schemas.message import type_name
from cairn.schemas.rcl_interfaces import Log
from cairn.schemas.std_msgs import Header
from tests.attack.inputs import valid
from tests.schemas.arbitrary import samples

MACHINE: Final = "brain"
COMPONENTS: Final = ("localizer", "vision_supervisor", "object_recognizer")
"""Those of this machine, as `test_hostile_machine.py` has them."""

TOPICS: Final[Mapping[str, type[Any]]] = {
    "/robot/localization": LocalizationEstimate,
    "/robot/recognized_objects": RecognizedObjectArray,
    "/robot/component_status": ComponentStatus,
    "/robot/root_brain/machine_status": MachineStatus,
    "/rosout": Log,
}
"""Topics on which this machine may publish, and components of the first one subscribe."""

RATE: Final = 10_000  # messages a second
TOKENS: Final = 3_000
_CODEC: Final = Codec()
_BLOCK: Final = zenoh.CongestionControl.BLOCK
_STATUS_S: Final = 0.2


def linked(endpoint: str, identity: str) -> zenoh.Session:
    """Open a router with a certificate, linked to that of the first machine."""
    config = zenoh.Config()
    folder = identity.rpartition("/identities/")[0]
    settings: dict[str, Any] = {
        "mode": "router",
        "listen/endpoints": [],  # by default it listens on all addresses
        "connect/endpoints": [endpoint],
        "connect/exit_on_failure": False,
        "connect/retry": {"period_init_ms": 50, "period_max_ms": 200},
        "scouting/multicast/enabled": False,
        "transport/link/rx/max_message_size": 1 << 30,
        "transport/link/tls": {
            "root_ca_certificate": f"{folder}/ca.pem",
            "connect_certificate": f"{identity}.pem",
            "connect_private_key": f"{identity}.key",
            "enable_mtls": True,
        },
    }
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)


class Attacker:
    """What has been sent, and how."""

    def __init__(self, session: zenoh.Session) -> None:
        self.session = session
        self.sent: dict[str, int] = {}
        self.has_ended = threading.Event()
        self._numbers = itertools.count(1)
        self._gid = secrets.token_bytes(16)
        self._kept: list[Any] = []

    def put(self, topic: str, payload: bytes) -> None:
        """Publish with an attachment as components send it."""
        attachment = Attachment(next(self._numbers), time.time_ns(), self._gid).encode()
        key = keys.message_key(0, topic, TOPICS[topic])
        self.session.put(key, payload, attachment=attachment, congestion_control=_BLOCK)
        self.sent[topic] = self.sent.get(topic, 0) + 1

    def garbage(self) -> None:
        """Damaged messages on each topic: noise, truncated ones, ones with other numbers."""
        messages = {topic: valid(message) for topic, message in TOPICS.items()}
        _report({})
        while not self.has_ended.wait(0.002):
            for topic, message in messages.items():
                noise = secrets.token_bytes(len(message))
                at = secrets.randbelow(len(message))
                self.put(topic, noise)
                self.put(topic, message[:at])
                self.put(topic, message[:at] + noise[at:])

    def large(self) -> None:
        """Messages of many megabytes on each topic, which the router takes."""
        self._large((1, 8, 31))

    def huge(self) -> None:
        """Messages of 50 MB, more than the router takes, which closes the link each time."""
        self._large((50,))

    def _large(self, megabytes: Sequence[int]) -> None:
        payloads = [bytes(size << 20) for size in megabytes]
        messages = {topic: valid(message) for topic, message in TOPICS.items()}
        _report({})
        while not self.has_ended.wait(0.01):
            for topic, message in messages.items():
                for payload in payloads:
                    if not self.has_ended.is_set():
                        self.put(topic, message + payload)

    def flood(self) -> None:
        """Valid messages on each topic but that of the pose, `RATE` in a second."""
        self._flood({topic for topic in TOPICS if topic != "/robot/localization"})

    def poses(self) -> None:
        """Wrong poses, `RATE` in a second."""
        self._flood({"/robot/localization"})

    def _flood(self, topics: set[str]) -> None:
        messages = {
            topic: itertools.cycle([_CODEC.encode(one) for one in samples(type_name(kind), 50)])
            for topic, kind in TOPICS.items()
            if topic in topics
        }
        _report({})
        began = time.monotonic()
        for number in itertools.count(1):
            for topic, following in messages.items():
                self.put(topic, next(following))
            ahead_s = began + number * len(messages) / RATE - time.monotonic()
            if self.has_ended.wait(ahead_s) if ahead_s > 0.01 else self.has_ended.is_set():
                return

    def tokens(self) -> None:
        """Announce thousands of endpoints of its own nodes, again and again."""
        zid = str(self.session.info.zid())
        entities = []
        for number in range(TOKENS):
            name = COMPONENTS[number % len(COMPONENTS)]
            topic = ("/robot/scan", "/robot/localization", "/robot/odom")[number % 3]
            node = NodeEntity(0, zid, number, f"/robot/{name}")
            kind = ("MP", "MS")[number % 2]
            message = LocalizationEstimate
            entities.append(
                EndpointEntity(
                    node, number, kind, topic, type_name(message),  # type: ignore[arg-type]
                    type_hash(message), RELIABLE,
                )
            )  # fmt: skip
        _report({})
        while not self.has_ended.wait(0.1):
            tokens = [self.session.liveliness().declare_token(keys.token_key(one))
                      for one in entities]  # fmt: skip
            self.sent["tokens"] = self.sent.get("tokens", 0) + len(tokens)
            self.has_ended.wait(1.0)
            for token in tokens:
                token.undeclare()

    def replies(self) -> None:
        """Answer every query falsely: too long, not at all, or thousands of times."""

        def many(query: zenoh.Query, key: str) -> None:
            for _ in range(2000):
                query.reply(key, b"x")

        behaviors: list[Callable[[zenoh.Query, str], None]] = [
            lambda query, key: query.reply(key, bytes(20 << 20)),
            many,
            lambda query, key: query.reply(key, b'{"value": "finalized"}'),
            lambda query, _: self._kept.append(query),
        ]
        numbers = itertools.count()

        def answer(query: zenoh.Query) -> None:
            if not self.has_ended.is_set():
                self.sent["replies"] = self.sent.get("replies", 0) + 1
                behaviors[next(numbers) % len(behaviors)](query, str(query.key_expr))
                del self._kept[:-1000]

        names = (*COMPONENTS, "root_brain", "cairn_up_brain")
        found = [keys.control_key(0, f"/robot/{name}") for name in names]
        found += [f"0/robot/{name}/**" for name in names]
        found += [f"{keys.message_key(0, one, kind)}/@adv/**" for one, kind in TOPICS.items()]
        found += [keys.session_key("*")]
        self._kept += [self.session.declare_queryable(key, answer) for key in found]
        _report({})
        self._lie()

    def flapping(self) -> None:
        """Be a machine that is found and lost, and claims that its components are active."""
        _report({})
        while not self.has_ended.is_set():
            self._lie(2.0)
            self.has_ended.wait(2.0)

    def lies(self) -> None:
        """Claim that all components are active and answer requests, but run none of them."""

        def answer(query: zenoh.Query) -> None:
            self.sent["replies"] = self.sent.get("replies", 0) + 1
            query.reply(str(query.key_expr), b'{"value": null}')

        key = keys.control_key(0, "/robot/root_brain")
        queryable = self.session.declare_queryable(key, answer)
        _report({})
        self._lie()
        queryable.undeclare()

    def _lie(self, duration_s: float = 3600.0) -> None:
        until = time.monotonic() + duration_s
        for number in itertools.count():
            if time.monotonic() > until or self.has_ended.wait(_STATUS_S):
                return
            states = ("active", "inactive", "ended", "\x1b[2J", "active")
            children = tuple(
                MachineChild(name, states[number // 10 % len(states)], number % 3, "x" * 1000)
                for name in COMPONENTS
            )
            now = from_ns(time.time_ns())
            link = MachineLink(machine="base", is_up=True, last_sent=now, last_received=now)
            status = MachineStatus(
                header=Header(stamp=now), machine=("brain", "base")[number % 2],
                children=children, links=(link,),
            )  # fmt: skip
            self.put("/robot/root_brain/machine_status", _CODEC.encode(status))


ATTACKS: Final = {
    "garbage": 1000, "large": 10, "huge": 2, "flood": 10_000, "poses": 10_000, "tokens": TOKENS,
    "replies": 10, "flapping": 10, "lies": 10,
}  # fmt: skip
"""The methods of `Attacker`, with what each sends at least during a drive of the robot."""


def _report(values: Mapping[str, float]) -> None:
    """Print a line of JSON: an empty object when the attack begins, and in the end what it sent."""
    sys.stdout.write(json.dumps(values) + "\n")
    sys.stdout.flush()


def main(attack: str, endpoint: str, identity: str) -> None:
    """Attack until the standard input closes."""
    session = linked(endpoint, identity)
    attacker = Attacker(session)
    thread = threading.Thread(target=getattr(attacker, attack))
    thread.start()
    began = time.monotonic()
    sys.stdin.read()
    attacker.has_ended.set()
    thread.join()
    _report(attacker.sent | {"seconds": round(time.monotonic() - began, 1)})
    session.close()


if __name__ == "__main__":
    main(*sys.argv[1:])

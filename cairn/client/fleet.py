"""The robots on the bus: how they are, what they do, and what they share about their map."""

from __future__ import annotations

import queue
import time
from collections.abc import Iterable, Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field, replace
from typing import Any, Final

from cairn.bus import keys
from cairn.bus.codec import Codec
from cairn.client.connection import Connection, SampleQueue
from cairn.schemas.cairn_msgs import RecordContributor, SharedLandmarks
from cairn.schemas.cairn_nav_msgs import (
    NAVIGATION_STATES,
    LocalizationEstimate,
    NavigationStatus,
)
from cairn.schemas.message import InvalidMessage, type_name

_LOCALIZATION: Final = "localization"
_NAVIGATION: Final = "navigation_status"
# Localizations come several times a second, what is shared once a second, and latched. A robot need
# not have had a mission.
_LIMIT_S: Final = 3.0
_LEAST_S: Final = 0.5
_MAX_ROBOTS: Final = 200


@dataclass(frozen=True)
class FleetRobot:
    """A robot on the bus.

    Attributes:
        name: its name.
        components: number of its components that have answered.
        failing: full names of those that are not active.
        health: reliability of its pose, 0 to 1; None if it publishes none.
        health_reason: what keeps it below 1.
        mission: state of its last mission (`NAVIGATION_STATES`); "" if it has had none.
        mission_reason: why the mission is in that state.
        shared: the landmarks that it shares; None if it shares none.
        behind: how many versions of the contributions of each robot it lacks, as far as another
            robot with the same map has them; empty if it is in sync.
    """

    name: str
    components: int = 0
    failing: tuple[str, ...] = ()
    health: float | None = None
    health_reason: str = ""
    mission: str = ""
    mission_reason: str = ""
    shared: SharedLandmarks | None = None
    behind: Mapping[str, int] = field(default_factory=dict)


def read_fleet(connection: Connection) -> list[FleetRobot]:
    """Return the robots on the bus, by name, from what they publish within 3 s."""
    statuses = connection.statuses()
    names = sorted({full.split("/")[1] for full in statuses})[:_MAX_ROBOTS]
    robots = {name: _with_components(name, statuses) for name in names}
    published = [end for end in connection.endpoints() if end.kind == "MP"]
    shares = [end for end in published if end.type_name == type_name(SharedLandmarks)]
    localizes = [end for end in published if end.topic.endswith(f"/{_LOCALIZATION}")]
    localized, missions, shared = _receive(
        connection,
        {end.topic for end in shares},
        {end.node.name.split("/")[1] for end in shares},
        {end.node.name.split("/")[1] for end in localizes},
    )
    for name, robot in robots.items():
        estimate, mission = localized.get(name), missions.get(name)
        robots[name] = replace(
            robot,
            health=None if estimate is None else estimate.health,
            health_reason="" if estimate is None else estimate.reason,
            mission="" if mission is None else NAVIGATION_STATES[mission.state],
            mission_reason="" if mission is None else mission.reason,
            shared=shared.get(name),
        )
    return [replace(one, behind=_behind(one, robots.values())) for one in robots.values()]


def _with_components(name: str, statuses: Mapping[str, Any]) -> FleetRobot:
    own = {full: one for full, one in statuses.items() if full.startswith(f"/{name}/")}
    failing = tuple(sorted(full for full, one in own.items() if one.state != "active"))
    return FleetRobot(name, len(own), failing)


def _receive(
    connection: Connection, shared_topics: Iterable[str], sharing: set[str], localizing: set[str]
) -> tuple[
    dict[str, LocalizationEstimate], dict[str, NavigationStatus], dict[str, SharedLandmarks]
]:
    """Return the newest localization, mission and shared landmarks of each robot, by name.

    It waits for the robots that publish them: those `sharing` and those `localizing`.
    """
    codec, samples = Codec(), SampleQueue()
    localized: dict[str, LocalizationEstimate] = {}
    missions: dict[str, NavigationStatus] = {}
    shared: dict[str, SharedLandmarks] = {}
    topics: list[tuple[str, type[Any]]] = [
        (f"/*/{_LOCALIZATION}", LocalizationEstimate),
        (f"/*/{_NAVIGATION}", NavigationStatus),
        *((topic, SharedLandmarks) for topic in sorted(shared_topics)),
    ]
    began = time.monotonic()
    with ExitStack() as stack:
        for topic, kind_of in topics:
            key = keys.message_key(connection.domain, topic, kind_of)
            stack.enter_context(connection.listen(key, latched=True, samples=samples))
        while True:
            complete = sharing <= shared.keys() and localizing <= localized.keys()
            left_s = began + (_LEAST_S if complete else _LIMIT_S) - time.monotonic()
            try:
                sample = samples.get(timeout=max(0.0, left_s))
            except queue.Empty:
                break
            if left_s < 0.0:
                break
            kind = str(sample.key_expr).rsplit("/", 2)[1]
            robot, payload = str(sample.key_expr).split("/")[1], sample.payload.to_bytes()
            with suppress(InvalidMessage):  # components count these at their ports
                if kind == keys.dds_type(type_name(LocalizationEstimate)):
                    localized[robot] = codec.decode(LocalizationEstimate, payload)
                elif kind == keys.dds_type(type_name(NavigationStatus)):
                    _keep_newest(missions, robot, codec.decode(NavigationStatus, payload))
                else:
                    message = codec.decode(SharedLandmarks, payload)
                    _keep_newest(shared, message.robot, message)
    return localized, missions, shared


def _keep_newest(known: dict[str, Any], robot: str, message: Any) -> None:
    """Keep a message unless a newer one is known: latched ones may arrive later."""
    stamp = message.header.stamp
    before = known.get(robot)
    if before is None or (before.header.stamp.sec, before.header.stamp.nanosec) <= (
        stamp.sec,
        stamp.nanosec,
    ):
        known[robot] = message


def _behind(robot: FleetRobot, robots: Iterable[FleetRobot]) -> dict[str, int]:
    """Return by how many versions a robot is behind others with its map, by contributor."""
    if robot.shared is None:
        return {}
    mine = {one.robot: one for one in robot.shared.contributors}
    newest: dict[str, RecordContributor] = {}
    for other in robots:
        if other.shared is not None and other.shared.map == robot.shared.map:
            for one in other.shared.contributors:
                if one.robot not in newest or newest[one.robot].newest < one.newest:
                    newest[one.robot] = one
    behind = {}
    for name, one in newest.items():
        own = mine.get(name)
        if own is None or own.newest < one.newest:
            behind[name] = one.newest - (0 if own is None else own.newest)
    return behind

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
from cairn.schemas.cairn_msgs import SharedCells, SharedLandmarks
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
        cells: the cells of its grid map that it shares; None if it shares none.
        behind: how many versions of the contributions of each robot it lacks, as far as another
            robot with the same visual map has them; empty if it is in sync.
        cells_behind: the robots whose newest decisions about cells it lacks, in the same way.
    """

    name: str
    components: int = 0
    failing: tuple[str, ...] = ()
    health: float | None = None
    health_reason: str = ""
    mission: str = ""
    mission_reason: str = ""
    shared: SharedLandmarks | None = None
    cells: SharedCells | None = None
    behind: Mapping[str, int] = field(default_factory=dict)
    cells_behind: tuple[str, ...] = ()


def read_fleet(connection: Connection) -> list[FleetRobot]:
    """Return the robots on the bus, by name, from what they publish within 3 s."""
    statuses = connection.statuses()
    names = sorted({full.split("/")[1] for full in statuses})[:_MAX_ROBOTS]
    robots = {name: _with_components(name, statuses) for name in names}
    published = [end for end in connection.endpoints() if end.kind == "MP"]
    shares = [end for end in published if end.type_name == type_name(SharedLandmarks)]
    shares_cells = [end for end in published if end.type_name == type_name(SharedCells)]
    localizes = [end for end in published if end.topic.endswith(f"/{_LOCALIZATION}")]
    localized, missions, shared, cells = _receive(connection, shares, shares_cells, localizes)
    for name, robot in robots.items():
        estimate, mission = localized.get(name), missions.get(name)
        robots[name] = replace(
            robot,
            health=None if estimate is None else estimate.health,
            health_reason="" if estimate is None else estimate.reason,
            mission="" if mission is None else NAVIGATION_STATES[mission.state],
            mission_reason="" if mission is None else mission.reason,
            shared=shared.get(name),
            cells=cells.get(name),
        )
    landmarks = [one.shared for one in robots.values() if one.shared is not None]
    grids = [one.cells for one in robots.values() if one.cells is not None]
    return [
        replace(
            one,
            behind={} if one.shared is None else _behind(one.shared, landmarks),
            cells_behind=() if one.cells is None else tuple(_behind(one.cells, grids)),
        )
        for one in robots.values()
    ]


def _with_components(name: str, statuses: Mapping[str, Any]) -> FleetRobot:
    own = {full: one for full, one in statuses.items() if full.startswith(f"/{name}/")}
    failing = tuple(sorted(full for full, one in own.items() if one.state != "active"))
    return FleetRobot(name, len(own), failing)


def _receive(
    connection: Connection,
    shares: Iterable[keys.EndpointEntity],
    shares_cells: Iterable[keys.EndpointEntity],
    localizes: Iterable[keys.EndpointEntity],
) -> tuple[
    dict[str, LocalizationEstimate],
    dict[str, NavigationStatus],
    dict[str, SharedLandmarks],
    dict[str, SharedCells],
]:
    """Return the newest localization, mission, shared landmarks and cells of each robot, by name.

    It waits for the robots that publish them, except for missions.
    """
    codec, samples = Codec(), SampleQueue()
    localized: dict[str, LocalizationEstimate] = {}
    missions: dict[str, NavigationStatus] = {}
    shared: dict[str, SharedLandmarks] = {}
    cells: dict[str, SharedCells] = {}
    expected: list[tuple[set[str], Mapping[str, Any]]] = [
        (_robots_of(shares), shared),
        (_robots_of(shares_cells), cells),
        (_robots_of(localizes), localized),
    ]
    topics: list[tuple[str, type[Any]]] = [
        (f"/*/{_LOCALIZATION}", LocalizationEstimate),
        (f"/*/{_NAVIGATION}", NavigationStatus),
        *((topic, SharedLandmarks) for topic in sorted({end.topic for end in shares})),
        *((topic, SharedCells) for topic in sorted({end.topic for end in shares_cells})),
    ]
    began = time.monotonic()
    with ExitStack() as stack:
        for topic, kind_of in topics:
            key = keys.message_key(connection.domain, topic, kind_of)
            stack.enter_context(connection.listen(key, latched=True, samples=samples))
        while True:
            complete = all(names <= received.keys() for names, received in expected)
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
                elif kind == keys.dds_type(type_name(SharedLandmarks)):
                    landmarks = codec.decode(SharedLandmarks, payload)
                    _keep_newest(shared, landmarks.robot, landmarks)
                else:
                    grid = codec.decode(SharedCells, payload)
                    _keep_newest(cells, grid.robot, grid)
    return localized, missions, shared, cells


def _robots_of(endpoints: Iterable[keys.EndpointEntity]) -> set[str]:
    return {end.node.name.split("/")[1] for end in endpoints}


def _keep_newest(known: dict[str, Any], robot: str, message: Any) -> None:
    """Keep a message unless a newer one is known: latched ones may arrive later."""
    stamp = message.header.stamp
    before = known.get(robot)
    if before is None or (before.header.stamp.sec, before.header.stamp.nanosec) <= (
        stamp.sec,
        stamp.nanosec,
    ):
        known[robot] = message


def _behind(
    one: SharedLandmarks | SharedCells, every: Iterable[SharedLandmarks | SharedCells]
) -> dict[str, int]:
    """Return by how much a robot is behind others with its map, by contributor."""
    mine = {each.robot: each.newest for each in one.contributors}
    newest: dict[str, int] = {}
    for other in every:
        if other.map == one.map:
            for each in other.contributors:
                newest[each.robot] = max(each.newest, newest.get(each.robot, 0))
    return {
        name: version - mine.get(name, 0)
        for name, version in newest.items()
        if version > mine.get(name, 0)
    }

"""`cairn fleet` lists the robots on the bus, and whether what they share has reached all."""

from collections.abc import Iterator
from dataclasses import replace

import pytest

from cairn import LATCHED
from cairn.schemas.cairn_msgs import (
    ComponentStatus,
    RecordContributor,
    SharedCells,
    SharedLandmarks,
)
from cairn.schemas.cairn_nav_msgs import LocalizationEstimate, NavigationStatus
from cairn.schemas.std_msgs import Header
from tests.cairn.bus.network import Network, node
from tests.commands import Answer, await_answer, cairn

pytestmark = pytest.mark.processes

FLEET = "/fleet/landmarks"
STATUS = ComponentStatus(header=Header(), component="map_builder", state="active")
CELLS = SharedCells(map="b" * 64, cells=73, rejected=2)
SHARED = SharedLandmarks(robot="robot_1", map="a" * 64, map_version=12, landmarks=10)


@pytest.fixture
def network() -> Iterator[Network]:
    network = Network()
    yield network
    network.close()


def fleet(network: Network, *options: str) -> Answer:
    return cairn("fleet", *options, connect=network.endpoint)


def test_fleet_lists_robots_with_what_they_share(network: Network) -> None:
    bus = network.bus()
    newest = {"robot_1": (5, 3), "robot_2": (2, 3)}  # what each has of both
    for name, (of_1, of_2) in newest.items():
        one = node(bus, f"/{name}/map_builder")
        contributors = (
            RecordContributor(robot="robot_1", newest=of_1, count=1),
            RecordContributor(robot="robot_2", newest=of_2, count=1),
        )
        shared = replace(SHARED, robot=name, contributors=contributors)
        one.advertise(FLEET, SharedLandmarks, LATCHED).publish(shared)
        decided = (RecordContributor(robot="robot_2", newest=of_1 * 10**9, count=1),)
        cells = replace(CELLS, robot=name, contributors=decided)
        one.advertise("/fleet/cells", SharedCells, LATCHED).publish(cells)
        one.advertise(f"/{name}/component_status", ComponentStatus, LATCHED).publish(STATUS)
        estimate = LocalizationEstimate(health=0.75, reason="it is turning")
        one.advertise(f"/{name}/localization", LocalizationEstimate, LATCHED).publish(estimate)
    alone = node(bus, "/robot_3/automove")
    failed = replace(STATUS, component="automove", state="error")
    alone.advertise("/robot_3/component_status", ComponentStatus, LATCHED).publish(failed)
    driving = NavigationStatus(state=NavigationStatus.DRIVING)
    alone.advertise("/robot_3/navigation_status", NavigationStatus, LATCHED).publish(driving)

    expected = [
        "robot state health mission map version landmarks grid cells shared rejected",
        "robot_1 active 0.75 aaaaaaaa 12 10 bbbbbbbb 73 in sync 2",
        "robot_2 active 0.75 aaaaaaaa 12 10 bbbbbbbb 73"
        " behind robot_1 by 3; cells behind robot_2 2",
        "robot_3 not active: automove driving no",
    ]
    # On a busy computer, some robots do not answer in time.
    shown = await_answer(
        lambda: fleet(network),
        lambda answer: [" ".join(row.split()) for row in answer.out.splitlines()] == expected,
    )

    assert (shown.code, shown.err) == (0, "")

    def is_complete(answer: Answer) -> bool:
        rows = answer.json
        return len(rows) == 3 and all(
            row["health"] and row["map"] and row["grid"] for row in rows[:2]
        )

    answer = await_answer(lambda: fleet(network, "--json"), is_complete)
    rows = {row["robot"]: row for row in answer.json}
    assert rows["robot_2"]["behind"] == {"robot_1": 3}
    assert rows["robot_2"]["cells_behind"] == ["robot_2"]
    assert rows["robot_1"]["health_reason"] == "it is turning"


def test_fleet_without_robots(network: Network) -> None:
    network.bus()

    assert fleet(network).out.startswith("there is no robot")

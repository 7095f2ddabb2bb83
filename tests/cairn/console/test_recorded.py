"""A console that plays a recording."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cairn import CairnError
from cairn.bus.codec import Codec
from cairn.console.operations import LIVE_METHODS, Operations
from cairn.console.recorded import RecordedOperations, RecordedSource
from cairn.console.recorded_state import state_at
from cairn.recording.reader import McapRecording
from cairn.schemas.builtin_interfaces import Time
from cairn.schemas.cairn_msgs import ComponentStatus, PortStatus, VisualMapChange
from cairn.schemas.cairn_nav_msgs import Collision
from cairn.schemas.map_msgs import OccupancyGridUpdate
from cairn.schemas.nav_msgs import MapMetaData, OccupancyGrid
from cairn.schemas.rcl_interfaces import Log
from cairn.schemas.std_msgs import Header, String
from tests.cairn.console.conftest import Page, Running, running
from tests.cairn.recording.recordings import BEGIN, SECOND, Sent, text, write_recording
from tests.wording import assert_words

LENGTH_S = 20


def status(at_s: int) -> ComponentStatus:
    port = PortStatus(
        port="words", topic="/robot/words", direction=PortStatus.OUT, messages=10 * at_s
    )
    stamp = Time(sec=BEGIN // SECOND + at_s)
    return ComponentStatus(
        header=Header(stamp=stamp), component="talker", state="active", pid=1, ports=(port,)
    )


@pytest.fixture
def file(tmp_path: Path) -> Path:
    sent = [Sent("/robot/map", 0, text("the map"), latched=True)]
    for second in range(LENGTH_S):
        at = second * SECOND
        sent.append(Sent("/robot/words", at, text(f"word {second}")))
        sent.append(Sent("/robot/component_status", at, status(second), latched=True))
    log = Log(stamp=Time(sec=5), level=20, name="robot.talker", msg="said it")
    sent.append(Sent("/rosout", 5 * SECOND, log))
    return write_recording(tmp_path / "run.mcap", sorted(sent, key=lambda one: one.at_ns))


@pytest.fixture
def player(file: Path) -> Iterator[Running]:
    source = RecordedSource(file)
    with running(source, "watch", operations=lambda hub: RecordedOperations(hub, source)) as player:
        yield player


def channels(page: Page) -> dict[str, int]:
    return {one["topic"]: one["id"] for one in page.text("advertise")["channels"]}


def words(page: Page) -> tuple[int, str]:
    """Return subscription and text of the next message."""
    subscription, _, payload = page.data()
    return subscription, Codec().decode(String, payload).data


def value(page: Page, method: str, **arguments: Any) -> Any:
    answer = page.call(method, **arguments)
    assert "error" not in answer, answer
    return answer["value"]


def test_recording_is_described_and_sought_with_the_last_message_of_each_topic(
    player: Running,
) -> None:
    page = player.browser()
    hello = page.event("hello")
    assert (hello["mode"], hello["may"], hello["robots"]) == ("recording", "watch", ["robot"])
    end = BEGIN + (LENGTH_S - 1) * SECOND
    times = {"start_ns": BEGIN, "end_ns": end, "file": "run.mcap"}
    assert times.items() <= hello["recording"].items()

    ids = channels(page)
    page.send(op="subscribe", subscriptions=[
        {"id": 1, "channelId": ids["/robot/map"]}, {"id": 2, "channelId": ids["/robot/words"]},
    ])  # fmt: skip
    assert {words(page), words(page)} == {(1, "the map"), (2, "word 0")}
    value(page, "seek", time_ns=BEGIN + 7 * SECOND + SECOND // 2)
    assert {words(page), words(page)} == {(1, "the map"), (2, "word 7")}
    value(page, "seek", time_ns=BEGIN + 2 * SECOND)
    assert {words(page), words(page)} == {(1, "the map"), (2, "word 2")}

    other = player.browser()
    other.send(op="subscribe", subscriptions=[{"id": 5, "channelId": ids["/robot/words"]}])
    assert words(other) == (5, "word 2")
    page.close()
    other.close()


def test_recording_plays_in_order_to_its_end_and_from_the_start_again(player: Running) -> None:
    page = player.browser()
    ids = channels(page)
    page.send(op="subscribe", subscriptions=[{"id": 2, "channelId": ids["/robot/words"]}])
    assert words(page) == (2, "word 0")

    assert value(page, "speed", factor=100.0)["speed"] == 100.0
    assert value(page, "play")["playing"]
    assert [words(page)[1] for _ in range(1, LENGTH_S)] == [f"word {k}" for k in range(1, LENGTH_S)]
    state = page.event("playback")
    while state["playing"] or state["time_ns"] < BEGIN + (LENGTH_S - 1) * SECOND:
        state = page.event("playback")
    value(page, "speed", factor=1.0)  # at 100, ten milliseconds later it would be word 1
    value(page, "play")
    assert words(page) == (2, "word 0")
    value(page, "pause")
    page.close()


def grid(at_s: int, value: int) -> OccupancyGrid:
    info = MapMetaData(width=3, height=2, resolution=0.05)
    return OccupancyGrid(header=stamped(at_s), info=info, data=np.full(6, value, np.int8))


def update(at_s: int, x: int, *values: int) -> OccupancyGridUpdate:
    data = np.array(values, np.int8)
    return OccupancyGridUpdate(
        header=stamped(at_s), x=x, y=1, width=len(values), height=1, data=data
    )


def stamped(at_s: int) -> Header:
    return Header(stamp=Time(sec=BEGIN // SECOND + at_s), frame_id="map")


def test_map_has_all_updates_since_it_at_any_time(tmp_path: Path) -> None:
    messages = [
        (1, grid(1, 0)), (2, update(2, 0, 10, 20)), (3, update(3, 1, 30, 40)),
        (4, update(4, 2, 50)),
        (5, update(5, 2, 1, 1)), (5, update(3, 0, 99)),  # not within the map; older than the last
        (6, grid(6, 7)), (7, update(7, 0, 60)), (9, String(data="the end")),
    ]  # fmt: skip
    topics = {OccupancyGrid: "/robot/map", OccupancyGridUpdate: "/robot/map_updates"}
    sent = [
        Sent(topics.get(type(one), "/robot/words"), at_s * SECOND, one, latched=at_s in (1, 6))
        for at_s, one in messages
    ]
    source = RecordedSource(write_recording(tmp_path / "map.mcap", sent))
    with running(source, "watch", operations=lambda hub: RecordedOperations(hub, source)) as player:
        page = player.browser()
        id_ = channels(page)["/robot/map"]

        def cells(page: Page) -> list[int]:
            return [int(one) for one in Codec().decode(OccupancyGrid, page.data()[2]).data]

        page.send(op="subscribe", subscriptions=[{"id": 1, "channelId": id_}])
        assert cells(page) == [0, 0, 0, 0, 0, 0]
        shown = []
        for at_s in (2.5, 3.5, 5.5, 6.5, 8.5, 3.5):
            value(page, "seek", time_ns=BEGIN + round(at_s * SECOND))
            shown.append(cells(page))
        assert [one[:3] for one in shown] == [[0] * 3, [0] * 3, [0] * 3, [7] * 3, [7] * 3, [0] * 3]
        rows = [one[3:] for one in shown]
        assert rows == [[10, 20, 0], [10, 30, 40], [10, 30, 50], [7] * 3, [60, 7, 7], [10, 30, 40]]

        other = player.browser()
        other.send(op="subscribe", subscriptions=[{"id": 5, "channelId": id_}])
        assert cells(other)[3:] == [10, 30, 40]
        page.close()
        other.close()


def test_changes_and_collisions_until_a_time_are_shown(tmp_path: Path) -> None:
    sent = [Sent("/robot/words", 0, text("the start"))]
    for at_s in (1, 2, 3, 400, 401):
        change = VisualMapChange(object_id=at_s, kind=VisualMapChange.REMOVED)
        sent.append(Sent("/robot/visual_map_changes", at_s * SECOND, change))
    hostile = VisualMapChange(object_id=9, reason="long" * 20_000)
    sent.append(Sent("/robot/visual_map_changes", 401 * SECOND, hostile))
    sent += [Sent("/robot/collisions", (402 + k) * SECOND, Collision(x=k)) for k in range(110)]
    source = RecordedSource(write_recording(tmp_path / "run.mcap", sent))
    with running(source, "watch", operations=lambda hub: RecordedOperations(hub, source)) as player:

        def shown(page: Page, count: int) -> list[int]:
            return [Codec().decode(VisualMapChange, page.data()[2]).object_id for _ in range(count)]

        page, other = player.browser(), player.browser()
        value(page, "seek", time_ns=BEGIN + 2 * SECOND)
        id_ = channels(page)["/robot/visual_map_changes"]
        page.send(op="subscribe", subscriptions=[{"id": 1, "channelId": id_}])
        assert shown(page, 2) == [1, 2]
        other.send(op="subscribe", subscriptions=[{"id": 1, "channelId": id_}])
        assert shown(other, 2) == [1, 2]
        assert shown(page, 2) == [1, 2]
        value(page, "seek", time_ns=BEGIN + 511 * SECOND)
        assert shown(page, 2) == [400, 401]  # not those of minutes before

        id_ = channels(other)["/robot/collisions"]
        other.send(op="subscribe", subscriptions=[{"id": 2, "channelId": id_}])
        received = [one for one in (other.data() for _ in range(102)) if one[0] == 2]
        positions = [Codec().decode(Collision, one[2]).x for one in received]
        assert positions == [*range(10, 110)]
        page.close()
        other.close()


def test_start_shows_what_was_latched_before_the_recorder_received_it(tmp_path: Path) -> None:
    early = SECOND // 2
    sent = [
        Sent("/robot/component_status", 0, status(0), latched=True),
        Sent("/robot/map", early, text("the map"), latched=True, delay_ns=SECOND),
        Sent("/robot/path", early, text("sent later"), latched=True),
        Sent("/robot/words", early, text("not latched"), delay_ns=SECOND),
        Sent("/robot/end", 9 * SECOND, text("the end")),
    ]
    with McapRecording(write_recording(tmp_path / "run.mcap", sent)) as recording:

        def shown(at_ns: int) -> list[str]:
            state = state_at(recording, BEGIN + at_ns, recording.channels)
            return [one.channel.topic.removeprefix("/robot/") for one in state]

        assert shown(0) == ["component_status", "map"]
        assert set(shown(early)) == {"component_status", "map", "path", "words"}


def test_states_and_logs_are_those_of_the_time_that_is_shown(player: Running) -> None:
    page = player.browser()
    assert value(page, "logs", robot="robot") == []
    while not (talker := page.event("components")["components"]):
        pass
    assert (talker[0]["name"], talker[0]["state"], talker[0]["pid"]) == ("talker", "active", 1)

    value(page, "seek", time_ns=BEGIN + 8 * SECOND)

    rate = None
    while rate is None:
        rates = {one["topic"]: one["rate_hz"] for one in page.event("topics")}
        rate = rates.get("/robot/words")
    assert rate == pytest.approx(10.0)
    assert [entry["msg"] for entry in value(page, "logs", robot="robot")] == ["said it"]
    page.close()


def test_whatever_would_steer_is_refused_with_the_reason(player: Running) -> None:
    page = player.browser()

    for method in ("go", "drive", "restart", "stop", "world"):
        answer = page.call(method, robot="robot", poses=[[1, 1, 0]])
        assert_words(answer["error"], method, "recording", "not steered")
    assert_words(page.call("seek", time_ns=-1)["error"], "time_ns")
    assert_words(page.call("speed", factor=0)["error"], "factor")
    page.close()


def test_attached_parameters_are_shown_also_where_a_file_has_none_that_can_be_read(
    tmp_path: Path,
) -> None:
    sent = [Sent("/robot/words", 0, text("word")), Sent("/robot/words", SECOND, text("word"))]

    def shown(content: bytes) -> tuple[dict[str, Any], dict[str, Any]]:
        attached = {"parameters.json": content}
        source = RecordedSource(write_recording(tmp_path / "p.mcap", sent, attachments=attached))
        with running(source, operations=lambda hub: RecordedOperations(hub, source)) as player:
            page = player.browser()
            about = page.event("hello")["recording"]
            answer = page.call("parameters", robot="robot", component="gate")
            assert_words(page.call("set_parameters")["error"], "set_parameters", "recording")
            page.close()
            return about, answer

    about, answer = shown(
        b'{"gate": {"limits": {"speed": 0.5}, "laws": [], "stop": true}, "a": {}}'
    )
    assert about["parameters"] == ["a", "gate"]
    values = {one["name"]: (one["value"], one["type"]) for one in answer["value"]}
    assert values == {"limits.speed": (0.5, "float"), "laws": ([], "list"), "stop": (True, "bool")}

    about, answer = shown(b'["not", "those"]')
    assert_words(about["notes"][0], "parameters.json", "not shown")
    assert_words(answer["error"], "gate", "parameters.json")


def test_methods_of_running_robots_are_all_known(console: Running) -> None:
    operations = console.hub.operations
    assert isinstance(operations, Operations)
    assert set(operations.methods) == set(LIVE_METHODS)


def test_recording_without_messages_is_refused(tmp_path: Path) -> None:
    with pytest.raises(CairnError, match="no messages"):
        RecordedSource(write_recording(tmp_path / "empty.mcap", []))

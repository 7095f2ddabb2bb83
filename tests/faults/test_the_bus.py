"""Errors on the bus are logged with topic, component, value and remedy; the rest keeps running."""

import math
import struct

import pytest

from cairn import RELIABLE
from cairn.bus import keys
from cairn.bus.codec import Codec
from cairn.bus.session import open_peer
from cairn.bus.zenoh_bus import ZenohBus
from cairn.schemas.geometry_msgs import PoseStamped, Twist, Vector3
from cairn.testing.launching import Launching
from tests.commands import await_status
from tests.patience import LIMIT_S

pytestmark = pytest.mark.processes


TALK = """
    components:
      listener: {plugin: test_listener}
      talker: {plugin: test_talker}
    """


@pytest.mark.accuracy
def test_second_router_at_a_socket_is_reported_with_remedies(launch: Launching) -> None:
    first = launch(TALK)
    first.await_line("child active: talker")
    second = launch(TALK, "--set", f"bus.socket={first.endpoint}")

    assert second.await_end() == 1

    second.await_line(
        f"cairn: cannot listen on {first.endpoint}: probably another deployment .*uses it; stop "
        r"that one, join it \(`--set bus.connect=\[...\]`\), or use another domain"
    )
    first.await_line("listener: received 10")
    assert first.stop() == 0


def test_another_message_type_on_a_topic_is_reported_to_both_components(launch: Launching) -> None:
    run = launch(TALK)
    run.await_line("listener: received 1")
    bus = ZenohBus(open_peer([run.endpoint]))
    try:
        reported: list[str] = []
        node = bus.node("/robot/stranger", reported.append)
        node.advertise("/robot/words", PoseStamped, RELIABLE)
        for component in ("listener", "talker"):
            run.await_line(
                f"ERROR   robot.{component}: topic /robot/words: /robot/stranger uses it with "
                f"type geometry_msgs/msg/PoseStamped, /robot/{component} with "
                "geometry_msgs/msg/Twist.*"
                "use the same type"
            )
    finally:
        bus.close()
    seen = len(run.lines)
    run.await_line("listener: received", after=seen)
    assert run.stop() == 0


def test_invalid_messages_of_a_foreign_node_are_rejected_and_counted(launch: Launching) -> None:
    run = launch(
        """
    external_topics: [words]
    components: {listener: {plugin: test_listener}}
    """
    )
    run.await_line("child active: listener")
    codec = Codec()
    key = keys.message_key(0, "/robot/words", Twist)
    good = codec.encode(Twist(linear=Vector3(x=42.0)))
    nan = good.replace(struct.pack("<d", 42.0), struct.pack("<d", math.nan))
    bus = ZenohBus(open_peer([run.endpoint]))
    try:
        assert bus.wait_for_peers(LIMIT_S) == []
        for payload in (nan, good[:20], good):
            bus.session.put(key, payload)
    finally:
        bus.close()

    refused = r"ERROR   robot.listener: port words: rejected invalid message on /robot/words"
    run.await_line(refused + r" \(1 so far\): .*linear.x = nan: must be a finite number")
    run.await_line(refused + r" \(2 so far\): .*20 bytes are not CDR")
    run.await_line("listener: received 1, the last was 42")
    listener = await_status(
        "/robot/listener", lambda row: (row["invalid"], row["received"]) == (2, 1), run.endpoint
    )
    assert listener["restarts"] == 0
    assert run.stop() == 0

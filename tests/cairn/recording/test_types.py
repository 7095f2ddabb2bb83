"""Recorded messages of every type of ROS 2, decoded to classes, or by their definitions."""

from __future__ import annotations

import time
import zlib
from typing import Any

import pytest

from cairn.bus.codec import Codec, to_plain
from cairn.bus.type_hash import definition, type_hash
from cairn.deployment.model import Deployment
from cairn.recording.decoding import MessageDecoder
from cairn.recording.mcap_file import RecordedChannel, RecordedMessage
from cairn.recording.run_attachments import MessageClasses
from cairn.schemas.interfaces import interface
from cairn.schemas.message import type_name
from tests.schemas.random_messages import RandomMessages, message_names
from tests.sweeps import sampled

CODEC = Codec()
NAMES = message_names()


def recorded(message: Any, **metadata: str) -> RecordedMessage:
    """Return a message as it is in a recording."""
    cls = type(message)
    channel = RecordedChannel(
        "/topic",
        type_name(cls),
        schema=definition(cls).encode(),
        metadata=tuple(({"type_hash": type_hash(cls)} | metadata).items()),
    )
    return RecordedMessage(channel, 1, 0, 0, CODEC.encode(message))


def messages(name: str) -> list[Any]:
    random = RandomMessages(zlib.crc32(name.encode()))
    return [random.make(interface(name)) for _ in range(3)]


@pytest.mark.parametrize("part", sampled(range(6)))
def test_messages_of_every_type_are_decoded_to_their_classes(part: int) -> None:
    decoder = MessageDecoder()
    for name in NAMES[part::6]:
        for message in messages(name):
            assert decoder.decode(recorded(message)) == message, name


@pytest.mark.accuracy
@pytest.mark.parametrize("part", range(6))
def test_messages_of_another_version_are_decoded_by_the_definition_in_the_recording(
    part: int,
) -> None:
    decoder = MessageDecoder()
    for name in NAMES[part::6]:
        for message in messages(name):
            found = decoder.decode(recorded(message, type_hash="RIHS01_of_another_version"))
            assert isinstance(found, dict), name
            assert repr(to_plain(found)) == repr(to_plain(message)), name


@pytest.mark.parametrize("line", ["", "  ", "# float32 b", "\r"], ids=repr)
def test_lines_without_a_field_cost_nothing(line: str) -> None:
    schema = f"int8 a\n{f'{line}{chr(10)}' * (250_000 // (len(line) + 1))}".encode()
    channel = RecordedChannel("/topic", "my_msgs/msg/One", schema=schema)
    began = time.process_time()

    found = MessageDecoder().decode(RecordedMessage(channel, 1, 0, 0, b"\0\1\0\0\5"))

    assert found == {"a": 5}
    assert time.process_time() - began < 1.0  # of the processor: 0.02 s


def test_recorder_finds_the_messages_of_actions_and_services() -> None:
    deployment = Deployment.model_validate(
        {"cairn": 1, "components": {"beacon": {"plugin": "test_beacon"}}}
    )
    for classes in (MessageClasses(None), MessageClasses(deployment)):
        feedback = classes.find("nav2_msgs/action/Spin_FeedbackMessage")
        assert feedback is interface("nav2_msgs/action/Spin_FeedbackMessage")
        assert classes.find("std_srvs/srv/Trigger_Event") is not None
        assert classes.find("std_srvs/srv/Trigger") is None
        assert classes.find("no_msgs/msg/X") is None

"""What a console that was open all the time shows at one time of a recording."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Collection
from dataclasses import replace
from typing import Final

import numpy as np

from cairn.bus.codec import Codec
from cairn.recording.mcap_file import RecordedChannel, RecordedMessage
from cairn.recording.reader import McapRecording
from cairn.schemas.builtin_interfaces import to_ns
from cairn.schemas.cairn_msgs import VisualMapChange
from cairn.schemas.cairn_nav_msgs import Collision
from cairn.schemas.map_msgs import OccupancyGridUpdate
from cairn.schemas.message import InvalidMessage, type_name
from cairn.schemas.nav_msgs import OccupancyGrid
from cairn.system.clock import SECOND

_MAP_TYPE: Final = type_name(OccupancyGrid)
_EVENT_TYPES: Final = frozenset((type_name(VisualMapChange), type_name(Collision)))
COLLECTED_TYPES: Final = _EVENT_TYPES | {_MAP_TYPE}
"""Types of messages of which the last one alone does not show the state."""
_UPDATE_TYPE: Final = type_name(OccupancyGridUpdate)
_UPDATES: Final = "_updates"  # ends the topic of a map's updates, as in ROS
_JOINING_NS: Final = 5 * SECOND  # within which a recorder gets the latched messages
_EVENTS_NS: Final = 300 * SECOND  # a longer time of a recording with images takes seconds to read
_MOST_EVENTS: Final = 100  # of a topic
_LONGEST_EVENT: Final = 64 << 10  # bytes


def state_at(
    recording: McapRecording, time_ns: int, channels: Collection[RecordedChannel]
) -> list[RecordedMessage]:
    """Return the messages that show the state of channels at a time, in order of their arrival.

    They are the last one of each publisher. At the start of the recording, that is also a latched
    message that was sent before, and that the recorder received a moment later. The grid map
    contains all updates since it. Of changes of the visual map, and of collisions, they are the
    last 100 of each topic within five minutes.
    """
    events = {one for one in channels if one.type in _EVENT_TYPES}
    found = recording.last_at(time_ns, set(channels) - events)
    found += _events(recording, time_ns, events)
    if time_ns < recording.start_ns + _JOINING_NS:
        found += _latched_before(recording, time_ns, set(channels) - {one.channel for one in found})
    newest = {one.channel.topic: one for one in found if one.channel.type == _MAP_TYPE}
    for topic, one in newest.items():
        updates = [
            channel
            for channel in recording.counts
            if channel.topic == topic + _UPDATES and channel.type == _UPDATE_TYPE
        ]
        if updates:
            found[found.index(one)] = _updated(recording, one, updates, time_ns)
    return sorted(found, key=lambda one: one.log_ns)


def _events(
    recording: McapRecording, time_ns: int, channels: Collection[RecordedChannel]
) -> list[RecordedMessage]:
    """Return the last messages of each topic, not only the last one."""
    newest: defaultdict[str, deque[RecordedMessage]] = defaultdict(deque)
    for one in recording.messages(max(0, time_ns - _EVENTS_NS), time_ns, channels):
        if len(one.data) > _LONGEST_EVENT:  # of a foreign node
            continue
        of_topic = newest[one.channel.topic]
        of_topic.append(one)
        if len(of_topic) > _MOST_EVENTS:
            of_topic.popleft()
    return [one for topic in newest.values() for one in topic]


def _latched_before(
    recording: McapRecording, time_ns: int, channels: Collection[RecordedChannel]
) -> list[RecordedMessage]:
    """Return the last latched messages that were sent up to a time and received soon after it."""
    latched = [one for one in channels if one.latched and recording.counts[one]]
    if not latched:
        return []
    received = recording.messages(time_ns + 1, recording.start_ns + _JOINING_NS, latched)
    sent = {one.channel: one for one in received if 0 < one.publish_ns <= time_ns}
    return list(sent.values())


def _updated(
    recording: McapRecording,
    message: RecordedMessage,
    updates: Collection[RecordedChannel],
    time_ns: int,
) -> RecordedMessage:
    """Return a grid map with all updates up to a time; it has the stamp of the last one.

    Updates that are not valid, older than the map, or not within it are left out.
    """
    codec = Codec()
    try:
        grid = codec.decode(OccupancyGrid, message.data)
    except InvalidMessage:
        return message  # of a foreign node; the page reports it
    height, width = grid.info.height, grid.info.width
    cells = np.array(grid.data).reshape(height, width)
    header = grid.header
    for one in recording.messages(message.log_ns, time_ns, updates):
        try:
            update = codec.decode(OccupancyGridUpdate, one.data)
        except InvalidMessage:
            continue
        x, y = update.x, update.y
        is_within = x >= 0 <= y and x + update.width <= width and y + update.height <= height
        if is_within and to_ns(update.header.stamp) >= to_ns(header.stamp):
            window = update.data.reshape(update.height, update.width)
            cells[y : y + update.height, x : x + update.width] = window
            header = update.header
    if header is grid.header:
        return message
    return message._replace(data=codec.encode(replace(grid, header=header, data=cells.ravel())))

"""Topics of a deployment whose publishers offer less than their subscribers request."""

from collections import defaultdict
from typing import Any

from cairn.bus.bus import full_name
from cairn.bus.conflicts import qos_mismatch
from cairn.deployment.exclusive_topics import ports_in
from cairn.deployment.model import Deployment
from cairn.runtime.topic_ports import In, Out


def qos_mismatches(deployment: Deployment) -> tuple[str, ...]:
    """Return a message about each pair of components whose QoS does not match, by topic.

    They do not prevent a start: Cairn delivers the messages nevertheless.
    """
    topics: defaultdict[str, list[tuple[str, In[Any] | Out[Any]]]] = defaultdict(list)
    for member, topic, port in ports_in(deployment):
        topics[topic].append((full_name(deployment.robot.name, member.name), port))
    found = (
        qos_mismatch(topic, publisher, offered.qos, subscriber, requested.qos)
        for topic, uses in sorted(topics.items())
        for publisher, offered in uses
        for subscriber, requested in uses
        if (offered.direction, requested.direction) == ("out", "in")
    )
    return tuple(filter(None, found))

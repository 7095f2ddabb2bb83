"""Limits on the length of messages of a deployment, from the inputs of its components."""

from collections import defaultdict

from cairn.bus.bus import full_name
from cairn.bus.message_limits import (
    MAX_MESSAGE_SIZE,
    TRANSPORT_FACTOR,
    MessageLimits,
    default_max_bytes,
)
from cairn.deployment.exclusive_topics import ports_in
from cairn.deployment.machines import machine_status_topic
from cairn.deployment.model import Deployment
from cairn.runtime.rosout import ROSOUT
from cairn.runtime.runtime import STATUS_TOPIC
from cairn.runtime.timers import CLOCK_TOPIC
from cairn.schemas.cairn_msgs import ComponentStatus, MachineStatus
from cairn.schemas.rcl_interfaces import Log
from cairn.schemas.rosgraph_msgs import Clock


def topic_limits(deployment: Deployment) -> MessageLimits:
    """Return what the transport accepts: on each topic enough for the input with the highest limit.

    A component whose plugin cannot be loaded is left out: its own start reports why.
    """
    longest: defaultdict[str, int] = defaultdict(int)
    for topic, message in (
        (STATUS_TOPIC, ComponentStatus), (CLOCK_TOPIC, Clock), (ROSOUT, Log),
    ):  # fmt: skip
        longest[full_name(deployment.robot.name, topic)] = default_max_bytes(message)
    for machine in deployment.machines:
        topic = machine_status_topic(deployment.robot.name, machine, deployment.main_machine)
        longest[topic] = default_max_bytes(MachineStatus)
    for _, topic, port in ports_in(deployment):
        if port.direction == "in":
            size = port.max_bytes or default_max_bytes(port.interface)
            longest[topic] = max(longest[topic], size)
    limit = deployment.bus.max_message_size or max(MAX_MESSAGE_SIZE, *longest.values())
    accepted = {topic: TRANSPORT_FACTOR * size for topic, size in longest.items()}
    return MessageLimits(
        max_message_size=limit,
        topics={topic: size for topic, size in accepted.items() if size < limit},
    )

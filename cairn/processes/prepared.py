"""What every component needs of the bus: made when the zygote imports it, shared by its forks.

Made in each process, it takes 1.3 MiB of each.
"""

from typing import Final

from cairn.bus.codec import Codec
from cairn.bus.type_hash import type_hash
from cairn.runtime.node_services import NODE_SERVICES
from cairn.schemas.cairn_msgs import ComponentStatus
from cairn.schemas.lifecycle_msgs.msg import TransitionEvent
from cairn.schemas.rcl_interfaces.msg import Log, ParameterEvent

_MESSAGES: Final = (ComponentStatus, Log, ParameterEvent, TransitionEvent)


def _prepared_codec() -> Codec:
    codec = Codec()
    for message in _MESSAGES:
        codec.prepare(message)
    for interface in (*_MESSAGES, *NODE_SERVICES):
        type_hash(interface)  # which keeps it
    return codec


CODEC: Final = _prepared_codec()
"""The codec of the bus of a process."""

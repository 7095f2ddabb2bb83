"""The message types that a console knows: all with definitions, and those of installed plugins."""

from __future__ import annotations

import asyncio
import json
import logging
import subprocess
import sys
from dataclasses import asdict, dataclass
from typing import Any, Final

from cairn.bus.message_limits import default_max_bytes, is_bulk
from cairn.bus.type_hash import definition, type_hash
from cairn.deployment.message_types import messages_of_plugins
from cairn.schemas.interfaces import find_message
from cairn.schemas.message import type_name

_LIMIT_S: Final = 120.0  # importing the plugins takes seconds, on a busy computer longer
_PROGRAM: Final = "from cairn.console.message_types import print_types; print_types()"

_log = logging.getLogger("cairn.console")


@dataclass(frozen=True)
class MessageType:
    """A message type.

    Attributes:
        name: its ROS 2 name.
        type_hash: of its definition.
        schema: its definition with all that it contains (ros2msg).
        is_bulk: whether its messages hold an image, a map or so.
        max_bytes: default limit of the length of its messages.
    """

    name: str
    type_hash: str
    schema: str
    is_bulk: bool
    max_bytes: int

    @classmethod
    def of(cls, message: type[Any]) -> MessageType:
        """Describe a message class."""
        name, limit = type_name(message), default_max_bytes(message)
        return cls(name, type_hash(message), definition(message), is_bulk(message), limit)


class MessageTypes:
    """Finds message types by name. Plugins' types are known after `load_plugins`."""

    def __init__(self) -> None:
        self._known: dict[str, MessageType] = {}

    def find(self, name: str) -> MessageType | None:
        """Return the type of this name; None if it is not known (yet)."""
        if name not in self._known and (message := find_message(name)) is not None:
            self._known[name] = MessageType.of(message)
        return self._known.get(name)

    async def load_plugins(self) -> None:
        """Learn the types of installed plugins; takes seconds.

        Another process imports the plugins, which take memory and may run any code.
        """
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-P", "-c", _PROGRAM,  # -P: not from the current folder
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
        )  # fmt: skip
        try:
            async with asyncio.timeout(_LIMIT_S):
                output, _ = await process.communicate()
            found = [MessageType(**one) for one in json.loads(output.splitlines()[-1])]
        except (TimeoutError, ValueError, TypeError, IndexError) as error:
            _log.warning("message types of plugins not known: %r", error)
            return
        finally:
            if process.returncode is None:
                process.kill()
        self._known |= {one.name: one for one in found}


def print_types() -> None:
    """Print the message types of installed plugins as JSON, in one line."""
    found = [MessageType.of(one) for one in messages_of_plugins().values()]
    sys.stdout.write(f"{json.dumps([asdict(one) for one in found])}\n")

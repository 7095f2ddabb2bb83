"""Runs an independent client of rmw_zenoh in a process of its own: see `ros2_client.py`."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from cairn.bus.type_hash import definition
from cairn.schemas.interfaces import packages
from cairn.schemas.message import Service, type_name


class Ros2:
    """The other client's process."""

    def __init__(self, process: "subprocess.Popen[str]") -> None:
        self._process = process

    def request(self, verb: str, **arguments: Any) -> Any:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps([verb, arguments]) + "\n")
        self._process.stdin.flush()
        answer = self._process.stdout.readline()
        assert answer, "the other client has ended; its errors are above"
        return json.loads(answer)


@contextmanager
def ros2_node(
    port: int,
    definitions: Path,
    messages: Iterable[type[Any]],
    environment: Mapping[str, str] | None = None,
) -> Iterator[Ros2]:
    """Run the client, which connects to a router at a TCP port and knows these message types."""
    write_definitions(definitions, messages)
    program = [sys.executable, str(Path(__file__).with_name("ros2_client.py"))]
    with subprocess.Popen(
        [*program, str(port), str(definitions)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, **(environment or {})},
    ) as process:
        try:
            yield Ros2(process)
        finally:
            process.kill()


def write_service_definitions(folder: Path, services: Iterable[type[Service[Any, Any]]]) -> None:
    """Copy the .srv file of each service, and write .msg files of its messages."""
    for service in services:
        package, _, name = type_name(service).split("/")
        target = folder / package / "srv" / f"{name}.srv"
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(packages()[package] / "srv" / target.name, target)
        # The client looks for files of both sides first, and would download the package.
        write_definitions(folder, (service.Request, service.Response))


def write_definitions(folder: Path, messages: Iterable[type[Any]]) -> None:
    """Write a .msg file for each message type and those that it contains, as in ROS 2."""
    for message in messages:
        first, *others = definition(message).split("=" * 80 + "\n")
        texts = {type_name(message): first}
        for other in others:
            title, _, text = other.partition("\n")
            package, name = title.removeprefix("MSG: ").split("/")
            texts[f"{package}/msg/{name}"] = text
        for name, text in texts.items():
            path = folder / f"{name}.msg"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)

"""Runs a node of dora-rs in a process of its own: see `dora_node.py`."""

import importlib.util
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from cairn.bus.endpoints import socket_path


class Dora:
    """The node's process."""

    def __init__(self, process: "subprocess.Popen[str]") -> None:
        self._process = process

    def do(self, verb: str, **arguments: Any) -> Any:
        """Make one of the node's requests; `AssertionError` with its error if it fails."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps([verb, arguments]) + "\n")
        self._process.stdin.flush()
        line = self._process.stdout.readline()
        assert line, "the dora node has ended; its errors are above"
        answer = json.loads(line)
        assert "error" not in answer, answer["error"]
        return answer["value"]

    def kill(self) -> None:
        """Kill the process."""
        self._process.kill()


@contextmanager
def dora_node(endpoint: str, ament: Path, folder: Path, name: str = "dora") -> Iterator[Dora]:
    """Run a node that is linked to the router at a Unix socket."""
    if importlib.util.find_spec("dora") is None:
        pytest.skip("dora-rs is not installed")
    config = folder / f"{name}.json5"
    settings = {
        "mode": "client",
        "connect": {"endpoints": [f"unixsock-stream/{socket_path(endpoint)}"]},
        "scouting": {"multicast": {"enabled": False}},
    }
    config.write_text(json.dumps(settings))
    program = str(Path(__file__).with_name("dora_node.py"))
    root = Path(__file__).parents[2]
    with subprocess.Popen(
        [sys.executable, program, str(config), name],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=root,
        env={**os.environ, "AMENT_PREFIX_PATH": str(ament), "PYTHONPATH": str(root)},
    ) as process:
        try:
            yield Dora(process)
        finally:
            process.kill()

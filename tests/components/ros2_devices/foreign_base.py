"""A base behind ROS 2, for tests: a router, and `base_node.py` as a program of its own."""

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import zenoh

from cairn.schemas.geometry_msgs import Twist, TwistStamped
from cairn.schemas.nav_msgs import Odometry
from cairn.testing.launching import free_port
from tests.cairn.bus.ros2 import write_definitions

_PROGRAM = Path(__file__).with_name("base_node.py")


class ForeignBase:
    """The base behind its router: a device as `cairn.testing.device` describes it."""

    def __init__(self, router: str, process: "subprocess.Popen[str]") -> None:
        self.router = router
        self._process = process
        self._session: zenoh.Session | None = None

    def unplug(self) -> None:
        """Stop its node and its router, as when its computer is switched off."""
        self._request("leave")
        self.stop_router()

    def plug_in(self) -> None:
        """Start both, if they do not run."""
        self.start_router()
        self._request("join")

    def stop_router(self) -> None:
        if self._session is not None:
            self._session.close()
            self._session = None

    def start_router(self) -> None:
        if self._session is None:
            self._session = zenoh.open(router_config(self.router))

    def turns(self) -> bool:
        return bool(self._request("turns"))

    def await_stand(self, limit_s: float) -> bool:
        return bool(self._request("await_stand", limit_s))

    def _request(self, verb: str, *arguments: Any) -> Any:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps([verb, *arguments]) + "\n")
        self._process.stdin.flush()
        answer = self._process.stdout.readline()
        assert answer, "the base's program has ended; its errors are above"
        return json.loads(answer)


@contextmanager
def foreign_base(folder: Path) -> Iterator[ForeignBase]:
    """Run a base that has joined for the time of the context."""
    port = free_port()
    endpoint = f"tcp/127.0.0.1:{port}"
    write_definitions(folder, (Odometry, Twist, TwistStamped))
    program = [sys.executable, str(_PROGRAM), str(port), str(folder)]
    pipe = subprocess.PIPE
    with subprocess.Popen(program, stdin=pipe, stdout=pipe, text=True) as process:
        base = ForeignBase(endpoint, process)
        try:
            base.plug_in()
            yield base
            base.unplug()
        finally:
            process.kill()


def router_config(endpoint: str) -> zenoh.Config:
    """Return the configuration of a router like `rmw_zenohd`."""
    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("adminspace/enabled", "true")
    return config

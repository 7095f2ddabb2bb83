"""A component's process that cannot be killed: an injected zygote, on a virtual clock."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import zenoh

from cairn.bus.session import open_router
from cairn.deployment.model import ChildSpec
from cairn.placement.launcher import ProcessHandle
from cairn.runtime.launch_request import LaunchRequest, RunContext
from cairn.supervision.child import ChildHandle
from cairn.supervision.supervisor import ChildGroup, Escalate
from cairn.supervision.zygote import Exited
from cairn.supervision.zygote_client import ChildProcess
from cairn.testing.launching import free_port
from tests.cairn.supervision.scripted_children import World

pytestmark = pytest.mark.processes


class UnkillableProcess(ChildProcess):
    """Does not join the bus, and does not end, as if it were in uninterruptible sleep."""

    def __init__(self, world: "UnkillableWorld") -> None:
        super().__init__(1234, lambda _: None)
        self._world = world

    def wait(self, timeout_s: float) -> Exited | None:
        self._world.now_s += timeout_s
        return None


class UnkillableWorld(World):
    """Launches such processes; it is the zygote as well."""

    def __init__(self, session: zenoh.Session) -> None:
        super().__init__()
        self.session = session
        self.spawned = 0

    def launch_child(  # type: ignore[override]  # a process, not a scripted child
        self, launch: LaunchRequest, on_exit: Callable[[], None]
    ) -> ChildHandle:
        handle = ProcessHandle(launch, self.session)
        handle.launch(self, on_exit)  # type: ignore[arg-type]  # only `spawn` is called
        return handle

    def spawn(self, *_: Any, **__: Any) -> ChildProcess:
        self.spawned += 1
        return UnkillableProcess(self)


@pytest.fixture
def session() -> Iterator[zenoh.Session]:
    with open_router(f"tcp/127.0.0.1:{free_port()}") as session:
        yield session


def test_process_that_neither_joins_the_bus_nor_can_be_killed_is_not_started_twice(
    session: zenoh.Session, tmp_path: Path
) -> None:
    world = UnkillableWorld(session)
    child = ChildSpec(plugin=f"{__name__}:Unused", interpreter="fresh", start_timeout_s=0.05)
    launch = LaunchRequest(
        name="root",
        spec=ChildSpec(plugin="supervisor", children={"base": child}),
        context=RunContext(log_folder=str(tmp_path)),
    )
    supervisor = ChildGroup(launch, world, world.log.logger, on_exit=lambda: None)

    with pytest.raises(Escalate, match="base does not end even when killed"):
        supervisor.start_all()

    assert world.spawned == 1

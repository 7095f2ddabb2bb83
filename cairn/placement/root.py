"""Runs a deployment in real processes: the router, the zygote, and the root of the tree."""

import os
import shutil
import signal
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol

from cairn.bus.bus import full_name
from cairn.bus.graph import read_graph
from cairn.bus.keys import NodeEntity
from cairn.bus.session import open_client, open_peer, open_router
from cairn.bus.zenoh_bus import ZenohBus
from cairn.deployment.model import ROOT, ChildSpec, Deployment
from cairn.errors import CairnError
from cairn.placement.attendance import Attendance
from cairn.placement.launchers import Household
from cairn.placement.service import ServiceManager
from cairn.process_exit import ExitReport
from cairn.runtime.launch_request import LaunchRequest, RunContext
from cairn.runtime.lifecycle import LifecycleState
from cairn.supervision.component import longest_handler_s
from cairn.supervision.zygote_process import ZygoteProcess, start_zygote

PROCESS_MODULE = "cairn.placement.process"
"""What every component's process runs: imported in the zygote, for all."""

_ZYGOTE_END_S = 0.2
_ZYGOTE_STOPPED_LIMIT_S = 2.0

_PLUGIN = "cairn.supervision.component:SupervisorComponent"


class Onlooker(Protocol):
    """Who looks on while a deployment runs: the view of `cairn up`."""

    def refresh(self) -> None:
        """Bring what is shown up to date; called every quarter of a second, or sooner."""
        ...

    def finish(self) -> None:
        """Show the last that has happened."""
        ...


@contextmanager
def started_zygote(modules: Sequence[str]) -> Iterator[ZygoteProcess]:
    """The zygote of a deployment, which imports the modules while the deployment is checked.

    Whatever it has started ends with the context. Raises `CairnError` if no folder for its socket
    can be made.
    """
    with _runtime_folder() as folder:
        zygote = start_zygote([PROCESS_MODULE, *modules], folder)
        try:
            yield zygote
        finally:
            zygote.close()


def run_processes(
    deployment: Deployment,
    zygote: ZygoteProcess,
    log_folder: Path,
    seed: int,
    watch: Callable[[ZenohBus, Callable[[], None]], Onlooker],
    service: ServiceManager | None = None,
) -> ExitReport:
    """Run a deployment until a significant component ends, it fails, or SIGINT or SIGTERM comes.

    `watch(bus, hurry)` returns who looks on; a call of `hurry` has it refreshed soon. `service` is
    told when all is active, and as long as the root lives. Nothing is left running, whatever
    happens. Raises `CairnError` if the port is taken, if the robot runs already on this bus or on a
    second signal, and what the onlooker raises, once everything has been stopped in good order.
    """
    if deployment.bus.connect:
        _refuse_namesake(deployment)
    with _bus(deployment) as bus:
        household = Household(_order(deployment, zygote, log_folder, seed), bus)
        attendance = Attendance(household)
        onlooker = watch(bus, attendance.hurry)
        return _run(household, attendance, onlooker, zygote, service or ServiceManager())


def _refuse_namesake(deployment: Deployment) -> None:
    """Two robots of one name would obey each other's orders, and mix up their topics."""
    name = full_name(deployment.robot, ROOT)
    session = open_client(deployment.bus.connect)
    try:
        nodes = read_graph(session, deployment.domain)
    finally:
        session.close()
    if any(isinstance(node, NodeEntity) and node.name == name for node in nodes):
        raise CairnError(
            f"a robot {deployment.robot} runs already on the bus of "
            f"{', '.join(deployment.bus.connect)}; give this one another name "
            "(`--set robot=NAME`), or stop the other"
        )


def endpoints(deployment: Deployment) -> tuple[str, ...]:
    """Where the components of a deployment find their router."""
    return deployment.bus.connect or (deployment.bus.listen,)


def _run(
    household: Household,
    attendance: Attendance,
    onlooker: Onlooker,
    zygote: ZygoteProcess,
    service: ServiceManager,
) -> ExitReport:
    hosted = household.hosted
    watch = _Watch(onlooker, zygote, attendance)

    def turn() -> None:
        watch.turn()
        status = hosted.runtime.status()
        sound = status.handler_s <= longest_handler_s(hosted.order.spec)
        service.tell(active=status.state == LifecycleState.ACTIVE, sound=sound)

    try:
        with attendance.signals(signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            hosted.ask("configure")
            hosted.ask("activate")
            if not attendance.until_end(turn, impatient=True):
                zygote.close()
                raise CairnError("stopped by force, on a second signal; nothing is left running")
        watch.finish()
    finally:
        household.close()
    if watch.failure is not None:
        raise watch.failure
    failed = hosted.end is None or not hosted.end.normal
    # The loss of its connection is noticed a moment before its end.
    if failed and zygote.ends_within(_ZYGOTE_END_S):
        return ExitReport(
            False, "the zygote was killed, and with it every component; nothing is left"
        )
    return hosted.end or ExitReport(False, "the root ended without a word")


class _Watch:
    """What is done at every turn of the main thread: the onlooker, and a look at the zygote."""

    def __init__(self, onlooker: Onlooker, zygote: ZygoteProcess, attendance: Attendance) -> None:
        self.failure: Exception | None = None  # the onlooker's; the robot stops in good order first
        self._onlooker = onlooker
        self._zygote = zygote
        self._attendance = attendance
        self._stopping = False
        self._zygote_stopped_at: float | None = None

    def turn(self) -> None:
        self._look(self._onlooker.refresh)
        self._kill_stopped_zygote()
        if not self._stopping and (self.failure is not None or not self._zygote.alive):
            self._stopping = True
            self._attendance.stop()

    def finish(self) -> None:
        self._look(self._onlooker.finish)

    def _kill_stopped_zygote(self) -> None:
        # Nobody could be started, stopped or found dead any more. Components die with it.
        now = time.monotonic()
        if not self._zygote.stopped:
            self._zygote_stopped_at = None
        elif self._zygote_stopped_at is None:
            self._zygote_stopped_at = now
        elif now - self._zygote_stopped_at > _ZYGOTE_STOPPED_LIMIT_S:
            self._zygote.kill()

    def _look(self, look: Callable[[], None]) -> None:
        if self.failure is None:
            try:
                look()
            except Exception as error:  # the terminal has gone, or the disk is full
                self.failure = error


def _order(
    deployment: Deployment, zygote: ZygoteProcess, log_folder: Path, seed: int
) -> LaunchRequest:
    return LaunchRequest(
        name=ROOT,
        spec=root_spec(deployment),
        context=RunContext(
            robot=deployment.robot,
            domain=deployment.domain,
            endpoints=endpoints(deployment),
            simulated_time=deployment.clock == "simulated",
            seed=seed,
            zygote=str(zygote.socket_path),
            log_folder=str(log_folder),
        ),
    )


def root_spec(deployment: Deployment) -> ChildSpec:
    """The root of the tree as a component."""
    return ChildSpec(
        plugin=_PLUGIN,
        placement="in_process",
        supervision=deployment.supervision,
        children=deployment.components,
    )


@contextmanager
def _bus(deployment: Deployment) -> Iterator[ZenohBus]:
    connect = deployment.bus.connect
    session = open_peer(connect) if connect else open_router(deployment.bus.listen)
    bus = ZenohBus(session, deployment.domain)
    try:
        yield bus
    finally:
        bus.close()


@contextmanager
def _runtime_folder() -> Iterator[Path]:
    base = os.environ.get("XDG_RUNTIME_DIR")
    try:
        folder = Path(tempfile.mkdtemp(prefix="cairn-", dir=base))
    except OSError as error:
        where = base or "the folder for temporary files"
        raise CairnError(f"no folder for sockets can be made in {where}: {error}") from error
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)

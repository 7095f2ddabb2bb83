"""Runs a deployment in real processes: the router, the zygote, and the root of the tree."""

import os
import shutil
import signal
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from cairn.bus.session import open_peer, open_router
from cairn.bus.zenoh_bus import ZenohBus
from cairn.component.runtime import End
from cairn.deployment.model import ComponentSpec, Deployment
from cairn.errors import CairnError
from cairn.placement.launchers import Household
from cairn.placement.order import Order, Surroundings, modules_of
from cairn.placement.process import HEARTBEAT_S
from cairn.supervision.component import SupervisorComponent
from cairn.supervision.zygote_process import ZygoteProcess, start_zygote

ROOT = "root"
_PLUGIN = "cairn.supervision.component:SupervisorComponent"


def run_processes(
    deployment: Deployment,
    log_folder: Path,
    seed: int,
    watch: Callable[[ZenohBus], Callable[[], None]],
) -> End:
    """Run a deployment until a significant component ends, it fails, or SIGINT or SIGTERM comes.

    `watch` is given the bus and returns what is to be called every quarter of a second. Nothing
    is left running, whatever happens. Raises `CairnError` if the port is taken.
    """
    with _runtime_folder() as folder:
        zygote = start_zygote(modules_of(deployment.components), folder)
        try:
            with _bus(deployment) as bus:
                order = _order(deployment, zygote, log_folder, seed)
                return _run(Household(order, bus), watch(bus), zygote)
        finally:
            zygote.close()


def endpoints(deployment: Deployment) -> tuple[str, ...]:
    """Where the components of a deployment find their router."""
    return deployment.bus.connect or (deployment.bus.listen,)


def _run(household: Household, refresh: Callable[[], None], zygote: ZygoteProcess) -> End:
    hosted = household.hosted
    supervisor = hosted.runtime.component
    assert isinstance(supervisor, SupervisorComponent)
    stopping = threading.Event()

    def stop(*_: object) -> None:
        supervisor.children.request_stop()
        if not stopping.is_set():
            stopping.set()
            hosted.ask("shutdown")

    before = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        hosted.ask("configure")
        hosted.ask("activate")
        while not hosted.ended.wait(HEARTBEAT_S):
            household.heartbeat()
            refresh()
            if not zygote.alive:
                stop()
        refresh()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        household.close()
    if not zygote.alive:
        return End(False, "the zygote was killed, and with it every component; nothing is left")
    return hosted.end or End(False, "the root ended without a word")


def _order(deployment: Deployment, zygote: ZygoteProcess, log_folder: Path, seed: int) -> Order:
    return Order(
        name=ROOT,
        parent="",
        incarnation=1,
        spec=root_spec(deployment),
        surroundings=Surroundings(
            robot=deployment.robot,
            domain=deployment.domain,
            endpoints=endpoints(deployment),
            simulated_time=deployment.clock == "simulated",
            seed=seed,
            zygote=str(zygote.socket_path),
            log_folder=str(log_folder),
        ),
    )


def root_spec(deployment: Deployment) -> ComponentSpec:
    """The root of the tree as a component."""
    return ComponentSpec(
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

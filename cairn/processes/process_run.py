"""Runs a deployment in real processes: the router, the zygote, and the root of the tree."""

import logging
import secrets
import shutil
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Protocol

from cairn.bus.bus import full_name
from cairn.bus.control import answering
from cairn.bus.credentials import NO_CREDENTIALS
from cairn.bus.endpoints import domain_socket, parse_endpoint
from cairn.bus.exclusive import KEY_BYTES
from cairn.bus.graph import read_graph
from cairn.bus.keys import nodes_pattern
from cairn.bus.session import (
    Gateway,
    close_session,
    open_client,
    open_peer,
    open_router,
    peer_socket,
)
from cairn.bus.zenoh_bus import ZenohBus
from cairn.deployment.machines import published_elsewhere
from cairn.deployment.model import ROOT, Deployment, root_name
from cairn.deployment.plugins import load_plugin
from cairn.errors import CairnError
from cairn.processes.certified_router import (
    AuthorityPoll,
    Certified,
    CertifiedRouter,
    gateway_for_operators,
    machine_links,
    opened_for_machines,
    opened_for_operators,
)
from cairn.processes.component_process import ComponentHost, MainLoop
from cairn.processes.forked_call import call_in_fork
from cairn.processes.launcher import ZygoteProcess, start_zygote
from cairn.processes.machine_identity import machine_secrets
from cairn.processes.machines import MachineMonitor
from cairn.processes.prepared import CODEC
from cairn.processes.run_plan import PLAN, REQUEST, PlanRequest, RunPlan, check_for_root
from cairn.processes.systemd_notify import ServiceManager
from cairn.runtime.child_spec import ChildSpec
from cairn.runtime.launch_request import LaunchRequest, RunContext
from cairn.runtime.lifecycle import LifecycleState
from cairn.runtime.process_exit import ExitLog, ExitReport
from cairn.system.heap import share_heap
from cairn.system.kernel_compilation import COMPILATION_LIMIT_S, before_compilation
from cairn.system.runtime_folder import run_folder

_log = logging.getLogger("cairn.root")
_ZYGOTE_STOPPED_LIMIT_S = 2.0
_ANSWER_LIMIT_S = 0.5  # of the components of a running robot, whatever their loops do
_IMPORTS_LIMIT_S = COMPILATION_LIMIT_S + 60.0
_CLOSE_LIMIT_S = 1.0  # of a link to a router
_FORCE_S = 1.0  # for the zygote to end, with all processes


class RunView(Protocol):
    """What shows the progress of a run: the view of `cairn up`."""

    def refresh(self) -> None:
        """Update what is shown; called every quarter of a second, or sooner."""

    def finish(self) -> None:
        """Show the last events."""


@contextmanager
def started_zygote(modules: Sequence[str]) -> Iterator[ZygoteProcess]:
    """Start the zygote, which imports these modules; call it before any thread is started.

    All processes that it has started end with the context. Raises `CairnError` if the folder for
    its socket cannot be created.
    """
    share_heap()
    with run_folder() as path:
        zygote = start_zygote([MainLoop.__module__, *modules], path)
        # Components in this process may need the same kernels, which one process compiles for all.
        before_compilation(lambda: zygote.wait_for_imports(_IMPORTS_LIMIT_S))
        try:
            yield zygote
        finally:
            zygote.close()


def checked_plan(zygote: ZygoteProcess, request: PlanRequest) -> RunPlan:
    """Return `check_and_plan` of a deployment, made by a fork of the zygote that runs it.

    Raises `CairnError` with everything that is wrong, before anything is started.
    """
    entry = f"{check_for_root.__module__}:{check_for_root.__name__}"
    argument = REQUEST.dump_python(request, mode="json")
    result = call_in_fork(zygote, "check", entry, argument, timeout_s=_IMPORTS_LIMIT_S)
    return PLAN.validate_python(result)


def run_processes(
    plan: RunPlan,
    zygote: ZygoteProcess,
    log_folder: Path,
    seed: int,
    make_view: Callable[[ZenohBus, Callable[[], None]], RunView],
    service: ServiceManager | None = None,
) -> ExitReport:
    """Run a deployment until a significant component ends, it fails, or SIGINT or SIGTERM comes.

    `make_view(bus, wake_up)` returns the view; `wake_up` has it refreshed soon. `service` is
    notified when all is active, and as long as the root runs. Nothing is left running, whatever
    happens; the zygote has ended, and its log is in `log_folder` if it has logged something.
    A view that fails, perhaps because its terminal is gone, does not end the run. Raises
    `CairnError` if the socket is in use, if the robot runs already on this bus, or on a second
    signal.
    """
    deployment, machine = plan.deployment, plan.machine
    bus_settings, folder = deployment.bus, zygote.socket_path.parent
    if bus_settings.connect:
        _check_robot_name_is_free(deployment)
    common = machine_secrets(deployment.robot.name) if machine else None
    secret = secrets.token_hex(16) if common is None else common.of_sessions()
    spec = plan.root()
    for one in _in_parent_process(spec, machine):
        load_plugin(one.plugin)  # before the start: importing may take long
    topics, limits = plan.exclusive_topics, plan.topic_limits
    launch = LaunchRequest(
        name=root_name(machine, deployment.main_machine),
        spec=spec,
        context=RunContext(
            robot=deployment.robot.name,
            domain=deployment.domain,
            endpoints=endpoints(deployment),
            simulated_time=deployment.clock == "simulated",
            seed=seed,
            call_log=deployment.has_call_log,
            deployment=deployment.model_dump_json(),
            stop_limit_s=deployment.stop_limit_s,
            zygote=str(zygote.socket_path),
            socket_folder=str(folder),
            credentials=bus_settings.credentials if bus_settings.connect else NO_CREDENTIALS,
            message_limits=limits,
            log_folder=str(log_folder),
            log_level=deployment.log_level,
            storage=deployment.storage,
            session_secret=secret,
            machine=machine,
            machines=tuple(deployment.machines),
            parents=plan.parents(),
            clock_tolerance_s=deployment.clock_tolerance_s,
            remote_topics=published_elsewhere(plan.remote_inputs, machine),
            exclusive_topics=topics,
        ),
        topic_keys={
            one.topic: common.of_topic(one.topic)
            if common is not None and one.several_machines
            else secrets.token_hex(KEY_BYTES)
            for one in topics
            if one.writer
        },
    )
    zygote_log = ExitLog(log_folder / "zygote.log")
    with _opened_bus(plan, folder, secret) as (bus, certified):
        root = ComponentHost(launch, bus)
        root.start()
        for router in certified:
            router.log = root.runtime.log  # so that it is shown, and reaches other machines
        loop = MainLoop(root)
        monitor = _Monitor(make_view(bus, loop.wake_up), zygote, loop)
        machines = MachineMonitor(root, plan.deployment, plan.remote_inputs) if machine else None
        service = service or ServiceManager()

        def on_turn() -> None:
            monitor.check()
            if machines is not None:
                machines.check()
            status = root.runtime.status()
            service.notify(
                active=status.state == LifecycleState.ACTIVE,
                healthy=status.handler_s <= launch.spec.handler_limit_s,
            )

        try:
            with loop.stop_signals(signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
                root.send_request("configure")
                root.send_request("activate")
                if not loop.run(on_turn, force=True):
                    zygote.close(_FORCE_S)
                    raise CairnError(
                        "stopped by force, on a second signal or because not everything had "
                        f"stopped within {deployment.stop_limit_s:g} s (stop_limit_s); nothing is "
                        "left running"
                    )
            monitor.finish()
        finally:
            root.close()
            # At its death a zygote closes its connections first: it may not have ended yet.
            zygote_ended_first = zygote.process.poll() is not None
            zygote.close()
            with suppress(OSError):  # it removes an empty log
                shutil.copyfile(zygote.log_file, zygote_log.file)
    report = root.exit_report or ExitReport(False, "the root ended without a report")
    if zygote_ended_first or (not report.normal and zygote.process.returncode != 0):
        cause = zygote_log.report(zygote.process.pid, zygote.process.returncode).reason
        reason = f"the zygote ended, and with it every component: {cause}; nothing is left running"
        return ExitReport(False, reason)
    return report


@contextmanager
def _opened_bus(
    plan: RunPlan, folder: Path, secret: str
) -> Iterator[tuple[ZenohBus, list[Certified]]]:
    """Open the bus of the root: the deployment's router and gateway, or a link to a router.

    Also yield what keeps the certificates of the routers current.
    """
    deployment, limits = plan.deployment, plan.topic_limits
    settings = deployment.bus
    certified: list[Certified] = []
    with ExitStack() as stack:
        if settings.connect:
            session = open_peer(
                settings.connect,
                peer_socket(folder, ROOT),
                settings.credentials,
                limits,
                secret,
            )
        else:
            socket = router_socket(deployment)
            listen = settings.listen if settings.allow_any_local_user else ()
            open_own = partial(open_router, socket, listen, settings.group, limits, secret)
            if plan.machine:
                # A session of its own, which can be replaced while the root goes on.
                read = partial(machine_links, deployment, plan.machine, plan.machine_access)
                open_linked = partial(opened_for_machines, open_own, secret)
                links = CertifiedRouter("links to other machines", read, open_linked)
                certified.append(stack.enter_context(closing(links)))
                poll = AuthorityPoll(deployment.robot.name, plan.machine)
                certified.append(stack.enter_context(closing(poll)))
                name = root_name(plan.machine, deployment.main_machine)
                session = open_peer(
                    endpoints(deployment), peer_socket(folder, name), limits=limits, secret=secret
                )
            else:
                session = open_own()
        several = bool(plan.machine)
        bus = stack.enter_context(
            closing(
                ZenohBus(
                    session, deployment.domain, secret, limits, CODEC, several_machines=several
                )
            )
        )
        if plan.gateway is not None:
            _open_gateway(plan, plan.gateway, folder, stack, certified)
        yield bus, certified


def _open_gateway(
    plan: RunPlan, gateway: Gateway, folder: Path, stack: ExitStack, certified: list[Certified]
) -> None:
    """Open the gateway between the network and the router until the stack closes.

    What keeps its certificates current is added to `certified`.
    """
    deployment, router = plan.deployment, router_socket(plan.deployment)
    tls = deployment.bus.tls
    if tls is None or tls.identity is None:
        stack.enter_context(closing(gateway.open(router, folder)))
        return
    read = partial(gateway_for_operators, gateway, deployment.robot.name, tls.identity)
    open_it = partial(opened_for_operators, router, folder)
    operators = CertifiedRouter("network endpoints", read, open_it)
    certified.append(stack.enter_context(closing(operators)))
    if tls.identity != plan.machine:  # which is polled for already
        poll = AuthorityPoll(deployment.robot.name, tls.identity)
        certified.append(stack.enter_context(closing(poll)))


def _in_parent_process(spec: ChildSpec, machine: str) -> Iterator[ChildSpec]:
    """Yield the components that run in the process of their supervisor here, at any depth."""
    for child in spec.children.values():
        if child.placement == "in_process" and (not machine or child.machine == machine):
            yield child
            yield from _in_parent_process(child, machine)


def endpoints(deployment: Deployment) -> tuple[str, ...]:
    """Return the endpoints at which the components of a deployment find their router."""
    return deployment.bus.connect or (parse_endpoint(str(router_socket(deployment))),)


def router_socket(deployment: Deployment) -> Path:
    """Return the path of the socket on which the router of a deployment listens."""
    named = deployment.bus.socket
    return domain_socket(deployment.domain) if named is None else Path(named)


def _check_robot_name_is_free(deployment: Deployment) -> None:
    """Two robots of one name would execute each other's commands, and share their topics."""
    name = full_name(deployment.robot.name, ROOT)
    session = open_client(deployment.bus.connect, deployment.bus.credentials)
    try:
        if not read_graph(session, nodes_pattern(deployment.domain, name)):
            return
        answers = answering(session, deployment.domain, deployment.robot.name, _ANSWER_LIMIT_S)
        runs = next(answers, None) is not None
    finally:
        close_session(session, _CLOSE_LIMIT_S)
    if runs:
        raise CairnError(
            f"a robot {deployment.robot.name} runs already on the bus of "
            f"{', '.join(deployment.bus.connect)}; give this one another name "
            "(`--set robot=NAME`), or stop the other"
        )
    _log.warning(
        "%s is announced on the bus, but no component of this robot answers within %g s: starting "
        "it; if processes of that name are stopped or hang, end them",
        name,
        _ANSWER_LIMIT_S,
    )


class _Monitor:
    """What the root's main thread does at every turn: refresh the view, and check the zygote."""

    def __init__(self, view: RunView, zygote: ZygoteProcess, loop: MainLoop) -> None:
        self._view = view
        self._shows = True
        self._zygote = zygote
        self._loop = loop
        self._stopping = False
        self._zygote_stopped_at: float | None = None

    def check(self) -> None:
        self._show(self._view.refresh)
        self._kill_stopped_zygote()
        if not self._stopping and self._zygote.process.poll() is not None:
            self._stopping = True
            self._loop.stop()

    def finish(self) -> None:
        self._show(self._view.finish)

    def _kill_stopped_zygote(self) -> None:
        # It could neither start nor stop a process, nor report an exit. Components die with it.
        now = time.monotonic()
        if not self._zygote.stopped:
            self._zygote_stopped_at = None
        elif self._zygote_stopped_at is None:
            self._zygote_stopped_at = now
        elif now - self._zygote_stopped_at > _ZYGOTE_STOPPED_LIMIT_S:
            self._zygote.process.kill()

    def _show(self, show: Callable[[], None]) -> None:
        if self._shows:
            try:
                show()
            except Exception as error:  # the terminal is gone, perhaps; the robot continues
                self._shows = False
                _log.error("view ended: %s: %s", type(error).__name__, error, exc_info=error)

"""`cairn up FILE`: run a deployment in the foreground, and own all of its processes."""

import gc
import json
import logging
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import typer

from cairn.bus.endpoints import DOMAIN_VARIABLE, default_domain, socket_path
from cairn.bus.zenoh_bus import ZenohBus
from cairn.cli.log_file import log_file
from cairn.cli.run_folders import check_report_option, reduce_old, used_folder, writing_report
from cairn.cli.up_messages import LogWatch, PlainView, View, Watch
from cairn.deployment.load import SourceDocument, assemble, read_sources
from cairn.deployment.machines import check_machine
from cairn.deployment.model import Deployment, root_name, view_name
from cairn.deployment.plugins import plugin_modules
from cairn.deployment.problems import DeploymentError
from cairn.errors import CairnError
from cairn.processes.launcher import ZygoteProcess
from cairn.processes.lockstep import LockstepRun
from cairn.processes.machine_identity import machine_identity
from cairn.processes.process_run import checked_plan, endpoints, run_processes, started_zygote
from cairn.processes.run_plan import PlanRequest, RunPlan, check_sources, with_recorder
from cairn.processes.systemd_notify import ServiceManager, service_manager
from cairn.runtime.child_spec import LogLevel
from cairn.runtime.process_exit import ExitReport
from cairn.schemas.builtin_interfaces import from_ns
from cairn.schemas.rcl_interfaces import Log
from cairn.system.signal_handlers import signal_handlers
from cairn.system.user_folders import state_folder
from cairn.terminal.options import File, Machine, Overlay, Set
from cairn.terminal.output import note
from cairn.terminal.run_output import RunOutput

_REPORT_SETTING = "report"
_CLOSING_TABLE = "report.txt"
_LONG_IMPORT_S = 4.0
_NEXT_NOTE_S = 10.0


def up(
    file: File,
    overlay: Overlay = None,
    set_: Set = None,
    lockstep: Annotated[
        bool,
        typer.Option(
            "--lockstep",
            help="Run in one process, in virtual time, with the same result in every run.",
        ),
    ] = False,
    seed: Annotated[int, typer.Option(min=0, help="Seed of everything random.")] = 0,
    machine: Machine = "",
    report: Annotated[
        Path | None,
        typer.Option(
            help="Folder for report and logs, which is created, also with its parent; by default "
            "one in the user's state folder."
        ),
    ] = None,
    log_level: Annotated[
        LogLevel | None,
        typer.Option(
            help="Lowest level of what components log that have no `log_level` of their own; while "
            "they run: `cairn param set NAME log_level=debug`.",
        ),
    ] = None,
    record: Annotated[
        bool,
        typer.Option(
            "--record",
            help="Record all topics to recording.mcap in the report's folder, for `cairn rerun`.",
        ),
    ] = False,
    console: Annotated[
        bool,
        typer.Option(
            "--console",
            help="Also run a console: a web page that shows and steers the robot, at the address "
            "that is printed.",
        ),
    ] = False,
    plain: Annotated[
        bool, typer.Option("--plain", help="Print lines, also on a terminal.")
    ] = False,
) -> None:
    """Run a deployment until it ends or Ctrl-C; no process is left running.

    FILE may be the name of a shipped deployment: `cairn up sim` runs the simulated robot. Reports
    and logs are written to a folder, never beside the deployment. Exit status 0 if the deployment
    has ended with success, 1 if not.
    """
    if console and lockstep:
        raise CairnError(
            "--console: a lockstep run has no bus to connect to; leave out --lockstep, or record "
            "the run (--record) and open the recording: `cairn console recording.mcap`"
        )
    if machine and lockstep:
        raise CairnError(
            "--machine: a lockstep run has the components of all machines in one process; leave "
            "out --machine"
        )
    service = service_manager(os.environ)
    folder = (report or _folder_of_run(file)).absolute()
    if report is not None:
        check_report_option(folder)
    began = time.monotonic()
    sources = read_sources(file, overlay or ())
    documents = [source.node.plain() for source in sources if source.node is not None]
    recording = _new_recording(folder) if record else None
    reported = _report_setting(documents, folder)
    level = [f"log_level={log_level}"] if log_level is not None else []
    sets = [*reported, *level, *(set_ or ())]
    if not lockstep and (
        machine or any(isinstance(one, dict) and "machines" in one for one in documents)
    ):
        _check_this_machine(file, sources, sets, machine)
    with ExitStack() as stack:
        if not lockstep:
            plugins = [*documents, {"plugin": "recorder"}] if record else documents
            modules = [name for document in plugins for name in plugin_modules(document)]
            zygote = stack.enter_context(started_zygote(modules))
        with _announced_long_import():
            if lockstep:
                deployment = check_sources(file, sources, sets)
                if recording is not None:
                    deployment = with_recorder(deployment, recording)
            else:
                request = PlanRequest(file, sources, sets, recording, machine)
                plan = checked_plan(zygote, request)
                deployment = plan.deployment
                if plan.added and deployment.call_log is None:
                    note(_NO_CALL_LOG)
        logs = stack.enter_context(used_folder(folder))
        with writing_report(folder, "--report"):
            (folder / _CLOSING_TABLE).unlink(missing_ok=True)
        if report is None:
            for text in reduce_old(_runs_folder(), deployment.storage, folder):
                note(text)
        output = RunOutput()
        stack.callback(output.close)
        where = ", lockstep" if lockstep else f", machine {machine}" if machine else ""
        title = f"{file.name}: robot {deployment.robot.name}{where}"
        live = sys.stdout.isatty() and not plain
        if not live:
            output.line(f"{title}; logs and report: {folder}")
        if deployment.bus.listen and deployment.bus.allow_any_local_user and not lockstep:
            reached = ", ".join(deployment.bus.listen)
            note(f"any user and program of this computer may drive the robot through {reached}")
        if deployment.domain != default_domain() and not lockstep:
            note(
                f"{file.name} sets domain {deployment.domain}: give other commands --domain "
                f"{deployment.domain}, or set {DOMAIN_VARIABLE}={deployment.domain}"
            )
        if lockstep and not any(member.spec.significant for member in deployment.members()):
            note("no component is `significant`: only Ctrl-C ends this run")
        facts = {"report and logs:": str(folder)}
        if not lockstep:
            listening = [str(socket_path(one) or one) for one in endpoints(deployment)]
            facts = {"listens at:": ", ".join([*listening, *deployment.bus.listen])} | facts
        with _live_view(title, facts) if live else nullcontext(PlainView(output.line)) as view:
            if console:
                stack.enter_context(_console(deployment, logs, facts if live else None, output))
            if lockstep:
                end = _run_lockstep(deployment, seed, logs, view)
            else:
                end = _run_processes(plan, zygote, seed, logs, view, service)
        table = folder / _CLOSING_TABLE
        if table.exists():
            output.line(table.read_text(encoding="utf-8"))
        if end.normal and end.success:
            took = time.monotonic() - began
            output.line(f"ended: {end.reason}; logs and report: {folder} (took {took:.1f} s)")
    if not (end.normal and end.success):
        raise CairnError(f"{file.name} failed: {end.reason.rstrip('.')}; logs: {logs}")


_NO_CALL_LOG = (
    "the recording has no call log of the components on other machines, which `cairn rerun` needs: "
    "set `call_log: true` in the deployment of all machines"
)


def _check_this_machine(
    file: Path, sources: Sequence[SourceDocument], sets: Sequence[str], machine: str
) -> None:
    """Raise `CairnError` unless this computer is a machine of the robot, and can prove that.

    The plan of the run needs the plugins, whose import may take minutes after an installation.
    """
    try:
        deployment = assemble(sources, sets, import_plugins=False)
    except DeploymentError:
        return  # the plan reports these problems, together with those that only plugins know
    check_machine(deployment, machine, file.name)
    if machine:
        machine_identity(deployment.robot.name, machine)


def _new_recording(folder: Path) -> Path:
    """Return the path of the recording; raises `CairnError` if one is there already."""
    path = folder / "recording.mcap"
    if path.exists():
        raise CairnError(
            f"{path} exists: move or remove it, or name another folder with --report; a recording "
            "is never replaced"
        )
    return path


@contextmanager
def _console(
    deployment: Deployment, logs: Path, facts: dict[str, str] | None, output: RunOutput
) -> Iterator[None]:
    """Run a console beside the deployment; its address is a fact of the live view, or a line."""
    from cairn.console.companion import console_beside

    if facts is not None:
        facts["console:"] = "starting"

    def report(address: str) -> None:
        if facts is not None:
            facts["console:"] = address
        else:
            output.line(f"console: {address}")

    log = logs / "console.log"
    with console_beside(endpoints(deployment)[0], deployment.domain, log, report, note):
        yield


def _live_view(title: str, facts: dict[str, str]) -> AbstractContextManager[View]:
    from rich.console import Console  # takes 50 ms: only for a terminal

    from cairn.cli.live_view import LiveView

    return LiveView(Console(), title, facts)


def _run_processes(
    plan: RunPlan,
    zygote: ZygoteProcess,
    seed: int,
    logs: Path,
    view: View,
    service: ServiceManager,
) -> ExitReport:
    deployment = plan.deployment
    with log_file(logs / "root.log", time.time_ns, deployment.storage):

        def watch(bus: ZenohBus, hurry: Callable[[], None]) -> LogWatch:
            names = plan.machine, deployment.main_machine
            return LogWatch(
                bus,
                deployment.robot.name,
                view,
                clock=deployment.clock == "simulated",
                hurry=hurry,
                root=root_name(*names),
                node=view_name(*names),
            )

        return run_processes(plan, zygote, logs, seed, watch, service)


def _run_lockstep(deployment: Deployment, seed: int, logs: Path, view: View) -> ExitReport:
    run = LockstepRun(deployment, seed)
    watch = Watch(run.bus, deployment.robot.name, view, clock=run.simulated)
    events = 0

    def refresh() -> None:
        nonlocal events
        events += 1
        if events % 1000 == 0:
            watch.refresh()

    # What was imported and built so far lives as long as the process: the garbage collector does
    # not have to visit it again and again, nor to free it at the end.
    gc.freeze()
    handler = _ViewHandler(view, run.executor.now)
    root_logger = logging.getLogger("cairn")
    root_logger.addHandler(handler)
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    try:
        with (
            signal_handlers(numbers, lambda *_: run.stop()),
            log_file(logs / "lockstep.log", run.executor.now, deployment.storage),
        ):
            return run.run(refresh)
    finally:
        root_logger.removeHandler(handler)


@contextmanager
def _announced_long_import() -> Iterator[None]:
    """Print a note if importing the plugins of a deployment takes long."""
    ended = threading.Event()

    def announce() -> None:
        began = time.monotonic()
        text = (
            "importing the plugins: a few seconds, or about a minute at the first start after an "
            "installation, which compiles kernels"
        )
        wait_s = _LONG_IMPORT_S
        while not ended.wait(wait_s):
            note(text)
            wait_s = _NEXT_NOTE_S
            text = f"importing the plugins: {time.monotonic() - began + wait_s:.0f} s so far"

    thread = threading.Thread(target=announce, name="notes", daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def _folder_of_run(file: Path) -> Path:
    """Return the path of a new folder in the user's state folder."""
    return _runs_folder() / f"{datetime.now(UTC):%Y%m%d-%H%M%S-%f}-{file.stem}"


def _runs_folder() -> Path:
    return state_folder("cairn") / "runs"


def _report_setting(documents: Iterable[Any], folder: Path) -> list[str]:
    """Return the assignment of the setting `report`, if the deployment has it."""
    for document in documents:
        settings = document.get("settings") if isinstance(document, dict) else None
        if isinstance(settings, dict) and _REPORT_SETTING in settings:
            return [f"{_REPORT_SETTING}={json.dumps(str(folder))}"]
    return []


class _ViewHandler(logging.Handler):
    """Passes log records to a view, with virtual time."""

    def __init__(self, view: View, now: Callable[[], int]) -> None:
        super().__init__()
        self._view = view
        self._now = now

    def emit(self, record: logging.LogRecord) -> None:
        self._view.log(
            Log(
                stamp=from_ns(self._now()),
                level=min(50, record.levelno // 10 * 10),
                name=record.name.removeprefix("cairn."),
                msg=record.getMessage().replace("\0", "?"),
            )
        )

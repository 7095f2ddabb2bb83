"""`cairn up FILE`: runs a deployment in the foreground, and owns every process of it."""

import json
import logging
import shutil
import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import platformdirs
import typer
import yaml
from rich.console import Console

from cairn.bus.zenoh_bus import ZenohBus
from cairn.cli.check import File, Overlay, Set
from cairn.cli.tables import line
from cairn.cli.view import LiveView, PlainView
from cairn.cli.watch import Watch
from cairn.clock import SECOND, from_ns
from cairn.component.runtime import End
from cairn.deployment.load import load_deployment
from cairn.deployment.model import Deployment
from cairn.errors import CairnError
from cairn.placement.lockstep_run import LockstepRun
from cairn.placement.process import LOG_FORMAT
from cairn.placement.root import run_processes
from schemas.rcl_interfaces import Log

_RUNS_KEPT = 20
_REPORT_SETTING = "report"
_CLOSING_TABLE = "report.txt"


def up(
    file: File,
    overlay: Overlay = None,
    set_: Set = None,
    lockstep: Annotated[
        bool, typer.Option("--lockstep", help="In one process on virtual time, reproducibly.")
    ] = False,
    seed: Annotated[int, typer.Option(min=0, help="Of all randomness.")] = 0,
    report: Annotated[
        Path | None,
        typer.Option(help="Folder for report and logs; by default one in the user's state folder."),
    ] = None,
    plain: Annotated[bool, typer.Option("--plain", help="Lines, even on a terminal.")] = False,
) -> None:
    """Run a deployment until it is done or Ctrl-C; nothing is left running.

    Exit status 0 if it ended as it should, 1 if it failed.
    """
    folder = _run_folder(file, report)
    where = _report_setting([file, *(overlay or ())], folder)
    deployment = load_deployment(file, overlay or (), [*where, *(set_ or ())])
    title = f"{file.name}: robot {deployment.robot}" + (", lockstep" if lockstep else "")
    live = sys.stdout.isatty() and not plain
    view = LiveView(Console(), title) if live else PlainView(line)
    with view:
        if lockstep:
            end = _run_lockstep(deployment, seed, folder, view)
        else:
            end = _run_processes(deployment, seed, folder, view)
    table = folder / _CLOSING_TABLE
    if table.exists():
        line(table.read_text(encoding="utf-8"))
    line(f"{'ended' if end.normal else 'FAILED'}: {end.reason}; logs and report: {folder}")
    if not end.normal:
        raise typer.Exit(1)


def _run_processes(
    deployment: Deployment, seed: int, folder: Path, view: LiveView | PlainView
) -> End:
    with _log_file(folder / "logs" / "root.log", time.time_ns):

        def watch(bus: ZenohBus) -> Callable[[], None]:
            return Watch(bus, deployment.robot, view).refresh

        return run_processes(deployment, folder / "logs", seed, watch)


def _run_lockstep(
    deployment: Deployment, seed: int, folder: Path, view: LiveView | PlainView
) -> End:
    run = LockstepRun(deployment, seed)
    watch = Watch(run.bus, deployment.robot, view, logs=False)
    events = 0

    def refresh() -> None:
        nonlocal events
        events += 1
        if events % 1000 == 0:
            watch.refresh()

    handler = _ViewHandler(view, run.executor.now)
    root_logger = logging.getLogger("cairn")
    root_logger.addHandler(handler)
    before = signal.signal(signal.SIGINT, lambda *_: run.stop())
    try:
        with _log_file(folder / "logs" / "lockstep.log", run.executor.now):
            return run.run(refresh)
    finally:
        signal.signal(signal.SIGINT, before)
        root_logger.removeHandler(handler)


@contextmanager
def _log_file(file: Path, now: Callable[[], int]) -> Iterator[None]:
    """Keep what the components of this process log in a file, with the time given by `now`."""
    file.parent.mkdir(parents=True, exist_ok=True)
    handler = logging.FileHandler(file, mode="w", encoding="utf-8")
    handler.setFormatter(_Formatter(now))
    logger = logging.getLogger("cairn")
    logger.setLevel(logging.INFO)
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        handler.close()


class _Formatter(logging.Formatter):
    def __init__(self, now: Callable[[], int]) -> None:
        super().__init__(LOG_FORMAT)
        self._now = now

    def formatTime(self, record: logging.LogRecord, datefmt: str | None = None) -> str:  # noqa: ARG002, N802
        return f"{self._now() / SECOND:.6f}"


def _run_folder(file: Path, report: Path | None) -> Path:
    """The folder of this run; without `report` one of the last few in the user's state folder."""
    if report is not None:
        folder = report
    else:
        runs = platformdirs.user_state_path("cairn") / "runs"
        for old in sorted(runs.glob("*"))[: -_RUNS_KEPT + 1 or None] if runs.exists() else []:
            shutil.rmtree(old, ignore_errors=True)
        folder = runs / f"{datetime.now(UTC):%Y%m%d-%H%M%S-%f}-{file.stem}"
    try:
        (folder / "logs").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CairnError(
            f"the report's folder {folder} cannot be made: {error.strerror}; name another one "
            "with --report"
        ) from error
    return folder


def _report_setting(files: Iterable[Path], folder: Path) -> list[str]:
    """Tell a deployment that has a setting `report` where its report goes."""
    for file in files:
        try:
            settings = (yaml.safe_load(file.read_bytes()) or {}).get("settings") or {}
        except (OSError, yaml.YAMLError, AttributeError):
            continue  # told, with its place, when the deployment is loaded
        if _REPORT_SETTING in settings:
            return [f"{_REPORT_SETTING}={json.dumps(str(folder))}"]
    return []


class _ViewHandler(logging.Handler):
    """Shows log records in a view, with virtual time."""

    def __init__(self, view: LiveView | PlainView, now: Callable[[], int]) -> None:
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

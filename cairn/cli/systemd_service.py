"""`cairn service install`, `status` and `uninstall`: run a deployment as a service of systemd."""

from __future__ import annotations

import os
import pwd
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

import typer

from cairn.deployment.load import load_deployment
from cairn.deployment.machines import check_machine
from cairn.deployment.shipped import FOLDER
from cairn.errors import CairnError
from cairn.processes.systemd_unit import (
    DROP_IN,
    TEMPLATE,
    RunCommand,
    drop_in_text,
    template_text,
    unit_name,
)
from cairn.system.files import explained, replace_file
from cairn.system.kernel_compilation import deferred_compilation
from cairn.system.user_folders import config_folder, state_folder
from cairn.terminal.options import File, Json, Machine, Overlay, Set
from cairn.terminal.output import line, note, show

_BOOTED: Final = Path("/run/systemd/system")  # sd_booted(3)
_SYSTEM_UNITS: Final = Path("/etc/systemd/system")
_SYSTEM_STATE: Final = Path("/var/lib/cairn")
_USERS: Final = FOLDER / "robot" / "cairn.sysusers"
_USER: Final = "cairn"
_HIDDEN: Final = tuple(map(Path, ("/home", "/root", "/run/user", "/tmp", "/var/tmp")))
"""What the template hides from the service (`ProtectHome`, `PrivateTmp`)."""
_UNIT_MODE: Final = 0o644
_FOLDER_MODE: Final = 0o755
_LINES: Final = 20
"""Lines of the journal that are printed when the service does not start."""
_LIMIT_S: Final = 60.0
_START_LIMIT_S: Final = 300.0
"""Longer than the template's `TimeoutStartSec`."""

UserUnit = Annotated[
    bool,
    typer.Option(
        "--user-unit/--system",
        help="A service of your own service manager, or of the system's, which runs it as the user "
        "cairn with the rights that it needs.",
    ),
]


def install(
    file: File,
    machine: Machine = "",
    overlay: Overlay = None,
    set_: Set = None,
    name: Annotated[
        str,
        typer.Option(
            help="Name of the service, which is cairn@NAME.", show_default="that of the file"
        ),
    ] = "",
    user_unit: UserUnit = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Print what would be written; change nothing.")
    ] = False,
) -> None:
    """Run a deployment as a service of systemd: at each boot, and again after a failure.

    The deployment is checked first. The unit and a drop-in with the command are written, the
    service is enabled and started; if it does not become active, the end of its log is printed, and
    the exit status is 1. A service that is installed already gets the new command, and is
    restarted if anything changed.
    """
    name = name or file.stem
    manager = _Manager(name, for_user=user_unit)
    with deferred_compilation():
        deployment = load_deployment(file, overlay or (), set_ or ())
    check_machine(deployment, machine, file.name)
    overlays = [one.absolute() for one in overlay or ()]
    report = manager.state / name
    command = RunCommand(_program(), file.absolute(), report, machine, overlays, set_ or ())
    texts = {
        manager.units / TEMPLATE: template_text(for_user=user_unit),
        manager.drop_in: drop_in_text(command, deployment, for_user=user_unit),
    }
    if dry_run:
        for path, text in texts.items():
            line(f"# {path}\n\n{text}")
        return
    manager.check(changes=True)
    if not user_unit:
        _warn_of_hidden([command.program, Path(sys.base_prefix), command.file, *overlays])
        _create_user()
    changed = [path for path, text in texts.items() if _write(path, text)]
    if not changed and manager.states()["ActiveState"] == "active":
        line(f"{manager.unit} is installed like this already, and active")
        return
    for path in changed:
        line(f"wrote {path}")
    manager.run("daemon-reload")
    if manager.states()["ActiveState"] == "failed":
        manager.run("reset-failed", manager.unit)  # or its limit of starts refuses this one
    manager.run("enable", manager.unit)
    # Not `enable --now`, which leaves a service that runs as it is.
    started = manager.attempt("restart", manager.unit, limit_s=_START_LIMIT_S)
    manager.check_active(started)
    line(f"{manager.unit} is enabled and active; its log: {manager.log_command}")
    if user_unit:
        user = pwd.getpwuid(os.geteuid()).pw_name
        note(f"it starts when {user} logs in; to start it at boot: loginctl enable-linger {user}")


def status(
    name: Annotated[
        str, typer.Argument(help="Name of the service; by default all that are installed.")
    ] = "",
    user_unit: UserUnit = False,
    json: Json = False,
) -> None:
    """Show the installed systemd services. Exit status 1 if one of them is not active."""
    name = _short(name)
    listing = _Manager(name or "robot", for_user=user_unit)
    listing.check(changes=False)
    names = [name] if name else listing.installed()
    rows = []
    for one in names:
        manager = _Manager(one, for_user=user_unit)
        states = manager.states()
        rows.append(
            {
                "service": manager.unit.removesuffix(".service"),
                "state": f"{states['ActiveState']} ({states['SubState']})",
                "at boot": states["UnitFileState"] or "not installed",
                "since": states["StateChangeTimestamp"],
                "restarts": int(states["NRestarts"] or 0),
                "pid": int(states["MainPID"] or 0) or None,
                "last result": states["Result"],
            }
        )
    columns = ("service", "state", "at boot", "since", "restarts", "pid", "last result")
    show(rows, columns, as_json=json, nothing="no robot is installed as a systemd service")
    if not all(str(row["state"]).startswith("active ") for row in rows):
        raise typer.Exit(1)


def uninstall(
    name: Annotated[str, typer.Argument(help="Name of the service, as `status` has it.")],
    user_unit: UserUnit = False,
) -> None:
    """Stop a systemd service and remove it; its reports, logs and maps stay."""
    name = _short(name)
    manager = _Manager(name, for_user=user_unit)
    manager.check(changes=True)
    if name not in manager.installed():
        known = ", ".join(manager.installed()) or "none"
        raise CairnError(f"{manager.unit} is not installed; installed services: {known}")
    manager.run("disable", "--now", manager.unit, limit_s=_START_LIMIT_S)
    shutil.rmtree(manager.drop_in.parent, ignore_errors=True)
    if not manager.installed():
        (manager.units / TEMPLATE).unlink(missing_ok=True)
    manager.run("daemon-reload")
    line(f"removed {manager.unit}; {manager.state / name} stays")


@dataclass(frozen=True)
class _Done:
    """How a command of systemd ended."""

    succeeded: bool
    text: str


class _Manager:
    """The service manager, the system's or the user's, and one service in it."""

    def __init__(self, name: str, *, for_user: bool) -> None:
        self.unit = unit_name(name)
        self._for_user = for_user
        self._options = ["--user"] if for_user else []
        self.units = config_folder("systemd") / "user" if for_user else _SYSTEM_UNITS
        self.state = state_folder("cairn") / "services" if for_user else _SYSTEM_STATE
        self.drop_in = self.units / f"{self.unit}.d" / DROP_IN

    @property
    def log_command(self) -> str:
        """The command that prints the log of the service."""
        return " ".join(["journalctl", *self._options, "-u", self.unit.removesuffix(".service")])

    def check(self, *, changes: bool) -> None:
        """Raise `CairnError` unless this manager runs, and this user may change it."""
        if shutil.which("systemctl") is None or not _BOOTED.is_dir():
            raise CairnError(
                "systemd does not run on this computer, so it cannot run a service; start the "
                "robot by `cairn up FILE --plain` from the service manager that it has"
            )
        if changes and not self._for_user and os.geteuid() != 0:
            raise CairnError(
                "only root may change the system's services; use sudo, or --user-unit for a "
                "service of your own"
            )
        done = self.attempt("show", "--property=Version")
        if not done.succeeded:
            raise CairnError(f"systemd does not answer: {done.text}; log in on this computer")

    def installed(self) -> list[str]:
        """Return the names of the services that are enabled, or have a drop-in."""
        places = [
            *self.units.glob("cairn@*.service.d"),
            *self.units.glob("*.wants/cairn@*.service"),
        ]
        names = {place.name.removesuffix(".d") for place in places}
        return sorted(map(_short, names))

    def states(self) -> dict[str, str]:
        """Return the properties of the service, as systemd has them."""
        names = (
            "ActiveState", "SubState", "Result", "NRestarts", "MainPID", "UnitFileState",
            "StateChangeTimestamp",
        )  # fmt: skip
        shown = self.run("show", self.unit, *(f"--property={name}" for name in names))
        found = dict(one.split("=", 1) for one in shown.splitlines() if "=" in one)
        return {name: found.get(name, "") for name in names}

    def check_active(self, started: _Done) -> None:
        """Raise `CairnError`, with the end of the log, unless the service is active."""
        states = self.states()
        if started.succeeded and states["ActiveState"] == "active":
            return
        log = ["--lines", str(_LINES), "--no-pager", "--output", "cat", "--unit", self.unit]
        journal = _run(["journalctl", *self._options, *log], _LIMIT_S)
        for text in journal.text.splitlines():
            note(f"  {text}")
        raise CairnError(
            f"{self.unit} is {states['ActiveState']} ({states['Result'] or started.text}), see the "
            f"end of its log above; it stays installed: correct the reason and repeat this "
            f"command, or remove it: cairn service uninstall {self.unit.removesuffix('.service')}"
            + (" --user-unit" if self._for_user else "")
        )

    def run(self, *words: str, limit_s: float = _LIMIT_S) -> str:
        """Run `systemctl`; return what it prints; raises `CairnError` if it fails."""
        done = self.attempt(*words, limit_s=limit_s)
        if not done.succeeded:
            raise CairnError(f"systemctl {' '.join(words)} failed: {done.text}")
        return done.text

    def attempt(self, *words: str, limit_s: float = _LIMIT_S) -> _Done:
        """Run `systemctl`; return how it ended."""
        return _run(["systemctl", *self._options, *words], limit_s)


def _run(words: Sequence[str], limit_s: float) -> _Done:
    try:
        done = subprocess.run(
            words, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            text=True, errors="replace", timeout=limit_s, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return _Done(False, f"no answer within {limit_s:g} s")
    except OSError as error:
        return _Done(False, f"{words[0]}: {error.strerror}")
    return _Done(done.returncode == 0, done.stdout.strip())


def _short(name: str) -> str:
    """Return the name of a service without what all have: of cairn@robot.service, robot."""
    return name.removeprefix("cairn@").removesuffix(".service")


def _program() -> Path:
    """Return the path of the program `cairn` as it was called: perhaps by a stable link."""
    called = Path(sys.argv[0]).absolute()
    if called.name == "cairn" and os.access(called, os.X_OK) and called.is_file():
        return called
    return Path(sys.prefix) / "bin" / "cairn"


def _warn_of_hidden(paths: Sequence[Path]) -> None:
    """Warn of paths that the template hides; a drop-in of the user's may show them."""
    for path in paths:
        for hidden in _HIDDEN:
            if path.is_relative_to(hidden) or path.resolve().is_relative_to(hidden):
                note(
                    f"warning: {path}: a service of the system does not see {hidden}, unless you "
                    "change that; keep deployments in /etc/cairn and Cairn in /opt/cairn, or use "
                    "--user-unit"
                )


def _create_user() -> None:
    """Create the user that robots run as, unless it exists."""
    try:
        pwd.getpwnam(_USER)
    except KeyError:
        done = _run(["systemd-sysusers", str(_USERS)], _LIMIT_S)
        if not done.succeeded:
            raise CairnError(f"systemd-sysusers {_USERS} failed: {done.text}") from None
        line(f"created the user {_USER}")


def _write(path: Path, text: str) -> bool:
    """Write a unit file; return whether it has changed. Raises `CairnError`."""
    data = text.encode()
    with explained(f"{path}: cannot be written"):
        if path.is_file() and path.read_bytes() == data:
            return False
        if not path.parent.exists():
            path.parent.mkdir(parents=True)
            path.parent.chmod(_FOLDER_MODE)
        replace_file(path, data)
        path.chmod(_UNIT_MODE)
    return True

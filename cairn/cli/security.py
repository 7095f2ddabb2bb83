"""`cairn security`: certificates for the machines of a robot and for users on the network."""

from __future__ import annotations

import asyncio
import re
import signal
import sys
import time
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from cairn.deployment.shipped import deployment_file
from cairn.errors import CairnError
from cairn.security.folder import RobotFolder, known_robots, security_folder
from cairn.security.roster import Entry, read_roster
from cairn.terminal.options import Json, Overlay, Set
from cairn.terminal.output import line, note, show

if TYPE_CHECKING:
    from cairn.deployment.model import Deployment
    from cairn.security.authority import Authority
    from cairn.security.identity import Identity

app = typer.Typer(
    help="Certificates for the machines of a robot and for users on the network.",
    no_args_is_help=True,
)

COLUMNS: Final = {
    "name": "name",
    "kind": "kind",
    "role": "role",
    "addresses": "addresses",
    "state": "state",
    "valid_until": "valid until (UTC)",
    "days_left": "days left",
}
_UNITS: Final = {"s": 1.0, "m": 60.0, "h": 3600.0, "d": 86_400.0}
_DEFAULT_LISTEN: Final = "127.0.0.1:7449"


class RoleName(StrEnum):
    """The roles of operators, as typed."""

    VIEW = "view"
    OPERATE = "operate"
    ADMINISTER = "administer"


def _duration(text: str) -> float:
    match = re.fullmatch(r"([0-9]{1,6})([smhd])", str(text))
    if match is None or int(match[1]) == 0:
        raise typer.BadParameter(f"{text!r} is not a duration; write 30s, 15m, 24h or 7d")
    return int(match[1]) * _UNITS[match[2]]


Robot = Annotated[
    str,
    typer.Option(
        "--robot",
        metavar="ROBOT",
        help="Name of the robot, if this computer has certificates of several.",
    ),
]
IdentityName = Annotated[
    str, typer.Argument(metavar="NAME", help="Name of the machine or operator.")
]
OptionalName = Annotated[
    str, typer.Argument(metavar="[NAME]", help="Name of the machine or operator.")
]
Days = Annotated[
    int, typer.Option(min=1, max=3650, help="Days for which new certificates are valid.")
]
Grace = Annotated[
    float,
    typer.Option(
        parser=_duration,
        metavar="DURATION",
        help="How long a renewed certificate remains in force.",
        show_default="24h",
    ),
]
DeploymentFile = Annotated[
    Path | None,
    typer.Option(
        "--deployment",
        metavar="FILE",
        parser=deployment_file,
        help="Take the robot's name, and its machines with their addresses, from this deployment.",
    ),
]
_DAYS: Final = 90
_GRACE: Final = "24h"


@app.command("init")
def init(
    robot: Annotated[
        str, typer.Option("--robot", metavar="ROBOT", help="Name of the robot (`robot:`).")
    ] = "",
    deployment: DeploymentFile = None,
    overlay: Overlay = None,
    set_: Set = None,
    machine: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=ADDRESS[,ADDRESS]...",
            help="A machine, with the IP addresses or host names at which others reach it.",
        ),
    ] = None,
    operator: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=ROLE",
            help="A user on the network, with the role view, operate or administer.",
        ),
    ] = None,
    days: Days = _DAYS,
    authority_days: Annotated[
        int, typer.Option(min=1, max=7300, help="Days for which the authority is valid.")
    ] = 3650,
) -> None:
    """Make an authority, with an identity for each machine and operator.

    The authority's key stays on this computer, which should not be one of the robot's.
    """
    from cairn.security.authority import Authority, members_of

    machines: dict[str, tuple[str, ...]] = {
        name: tuple(text.split(",")) for name, text in _pairs(machine, "--machine")
    }
    operators: dict[str, Any] = {
        name: _role(name, text) for name, text in _pairs(operator, "--operator")
    }
    loaded = _loaded(deployment, overlay, set_)
    if loaded is not None:
        if robot not in ("", loaded.robot.name):
            raise CairnError(
                f"--robot {robot}: the robot of {deployment} is {loaded.robot.name}; leave out "
                "--robot"
            )
        robot = loaded.robot.name
        of_deployment: dict[str, tuple[str, ...]] = {
            name: (one.address,) for name, one in loaded.machines.items()
        }
        for name, further in machines.items():
            of_deployment[name] = (*of_deployment.get(name, ()), *further)
        machines = of_deployment
    if not robot:
        raise CairnError("give the name of the robot by --robot, or its deployment by --deployment")
    folder = RobotFolder.of(robot)
    authority = Authority.create(folder, members_of(machines, operators), days, authority_days)
    line(f"authority of {robot}: {folder.path}")
    line(f"fingerprint: {authority.fingerprint}")
    line(f"keep {folder.ca_key} secret, and a copy of the folder in a safe place")
    for entry in authority.roster().entries:
        line(_described(entry))
    note(
        "next: run `cairn security serve --listen ADDRESS:7449` here, at an address that the "
        "others reach; then for each of them `cairn security token NAME` here, and `cairn security "
        "enroll -` there"
    )


@app.command("add")
def add(
    name: OptionalName = "",
    address: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ADDRESS", help="It is a machine that others reach at this address; repeatable."
        ),
    ] = None,
    role: Annotated[RoleName | None, typer.Option(help="It is an operator with this role.")] = None,
    deployment: DeploymentFile = None,
    overlay: Overlay = None,
    set_: Set = None,
    days: Days = _DAYS,
    robot: Robot = "",
) -> None:
    """Add a machine or operator; with --deployment, all its machines that have no identity yet."""
    from cairn.security.authority import members_of

    loaded = _loaded(deployment, overlay, set_)
    if loaded is not None:
        if name or address or role is not None or robot:
            raise CairnError(
                "--deployment has the robot and its machines; leave out NAME, --address, --role "
                "and --robot"
            )
        _add_machines(loaded, days)
        return
    if not name:
        raise CairnError("give the NAME of a machine or operator, or --deployment")
    if bool(address) == (role is not None):
        raise CairnError(
            f"{name}: give --address for a machine, or --role for an operator, and not both"
        )
    machines = {name: tuple(address)} if address else {}
    operators: dict[str, Any] = {name: role.value} if role is not None else {}
    (member,) = members_of(machines, operators)
    line(_described(_authority(robot).add(member, days)))
    note(_ENROLLS)


_ENROLLS: Final = (
    "next: `cairn security token NAME` here, while the service runs (cairn security serve), and "
    "`cairn security enroll -` on its computer"
)


def _add_machines(deployment: Deployment, days: int) -> None:
    """Add the machines of a deployment that have no identity, and note what else differs."""
    from cairn.security.authority import members_of

    authority = _authority(deployment.robot.name)
    roster = authority.roster()
    machines = {name: one.address for name, one in deployment.machines.items()}
    known = {name: entry for name in machines if (entry := roster.current(name)) is not None}
    missing = {name: (address,) for name, address in machines.items() if name not in known}
    for member in members_of(missing, {}):
        line(_described(authority.add(member, days)))
    if missing:
        note(_ENROLLS)
    else:
        line("all machines of the deployment have an identity")
    for name, entry in known.items():
        if entry.kind != "machine":
            note(f"{name}: it is an operator; rename the machine, or revoke the operator")
        elif machines[name] not in entry.addresses:
            note(
                f"{name}: its address is {machines[name]} in the deployment, and "
                f"{', '.join(entry.addresses)} in its certificate, so the other machines refuse "
                f"it; revoke it (cairn security revoke {name}), and run this command again"
            )
    for entry in roster.entries:
        if entry.kind == "machine" and entry.is_current and entry.name not in machines:
            note(
                f"{entry.name}: the deployment has no such machine; if it is no longer used: cairn "
                f"security revoke {entry.name}"
            )


@app.command("list")
def list_identities(json: Json = False, robot: Robot = "") -> None:
    """List the identities: role, validity, and which are revoked."""
    roster = read_roster(_folder(robot))
    now = time.time()
    rows = [_row(entry, now) for entry in sorted(roster.entries, key=_order)]
    show(rows, COLUMNS, as_json=json, nothing="the robot has no identities")


@app.command("renew")
def renew(
    name: OptionalName = "",
    all_of_them: Annotated[
        bool, typer.Option("--all", help="Renew all whose keys are on this computer.")
    ] = False,
    days: Annotated[
        int | None,
        typer.Option(min=1, max=3650, help="Days for which it is valid.", show_default="90"),
    ] = None,
    grace: Annotated[
        float | None,
        typer.Option(
            parser=_duration,
            metavar="DURATION",
            help="How long the earlier certificate remains in force.",
            show_default="24h",
        ),
    ] = None,
    robot: Robot = "",
) -> None:
    """Replace key and certificate of an identity whose key is on this computer.

    Elsewhere than on the authority's computer, its service is asked and decides about --days and
    --grace.
    """
    from cairn.security.authority import GRACE_S, VALID_DAYS, Authority
    from cairn.security.enrollment import read_url, renew_own
    from cairn.security.identity import own_names

    folder = _folder(robot)
    if bool(name) == all_of_them:
        raise CairnError("give the name of an identity, or --all")
    names = own_names(folder) if all_of_them else [name]
    if not names:
        raise CairnError(f"{folder.identities}: there are no keys on this computer; nothing to do")
    authority = Authority(folder) if folder.ca_key.exists() else None
    if authority is None and (days, grace) != (None, None):
        raise CairnError(
            "--days and --grace: the authority's service decides about them; give them to `cairn "
            "security serve`"
        )
    for one in names:
        if authority is not None:
            entry = authority.renew(one, days or VALID_DAYS, GRACE_S if grace is None else grace)
        else:
            url = read_url(folder, f"enroll {one} again (cairn security enroll)")
            entry = renew_own(folder, one, url).entry
        line(f"renewed {_described(entry)}")
    if authority is not None:
        note("a renewed identity that is used on another computer has to be exported again")


@app.command("revoke")
def revoke(name: IdentityName, robot: Robot = "") -> None:
    """Revoke all certificates of an identity permanently.

    Machines refuse them as soon as they have the new roster.
    """
    authority = _authority(robot)
    count = authority.revoke(name)
    line(f"revoked {name}: {count} certificate{'s' if count > 1 else ''}")
    line(f"the roster has version {authority.roster().version}; machines have to fetch it")


@app.command("export")
def export(
    name: IdentityName,
    to: Annotated[Path, typer.Option("--to", metavar="FILE", help="The new file.")],
    robot: Robot = "",
) -> None:
    """Write an identity with its private key to a file, to copy it by hand.

    Remove the file afterwards. With `cairn security enroll`, no key is copied.
    """
    from cairn.security.bundle import export_identity

    identity = export_identity(_folder(robot), name, to)
    line(f"{to}: {_described(identity.entry)}")
    note(f"the file contains the private key of {name}: remove it after `cairn security import`")


@app.command("import")
def import_file(
    file: Annotated[Path, typer.Argument(help="File that `cairn security export` has written.")],
) -> None:
    """Take an exported identity into this computer's security folder."""
    from cairn.security.bundle import import_identity

    _report_own(import_identity(file))


@app.command("token")
def token(
    name: IdentityName,
    valid: Annotated[
        float,
        typer.Option(
            parser=_duration,
            metavar="DURATION",
            help="How long the token can be used; at most 7d.",
            show_default="15m",
        ),
    ] = "15m",  # type: ignore[assignment] # typer parses it
    robot: Robot = "",
) -> None:
    """Print a token with which the computer of an identity enrolls, once."""
    from cairn.security.enrollment import read_url
    from cairn.security.tokens import LONGEST_VALID_S, Token

    if valid > LONGEST_VALID_S:
        raise CairnError("--valid: a token is valid for at most 7d; give a shorter time")
    authority = _authority(robot)
    folder = authority.folder
    url = read_url(folder, "start the service first: cairn security serve")
    secret = authority.new_token(name, valid)
    made = Token(url=url, ca=authority.fingerprint, robot=folder.robot, name=name, secret=secret)
    line(made.encode())
    end = _utc(time.time() + valid)
    note(f"on the computer of {name}, until {end} UTC, once: cairn security enroll TOKEN")


@app.command("serve")
def serve(
    listen: Annotated[
        str,
        typer.Option(metavar="HOST:PORT", help="Address to listen on; port 0: any free one."),
    ] = _DEFAULT_LISTEN,
    name: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ADDRESS",
            help="Address at which machines reach it, if it is not HOST; repeatable.",
        ),
    ] = None,
    days: Days = _DAYS,
    grace: Grace = _GRACE,  # type: ignore[assignment] # typer parses it
    robot: Robot = "",
) -> None:
    """Run the authority's service: enrollment, renewal and the roster, over TLS.

    It may run all the time, or only while machines enroll or renew.
    """
    from cairn.security.service import AuthorityService

    match = re.fullmatch(r"\[?([^\[\]]+)\]?:([0-9]{1,5})", listen)
    if match is None or int(match[2]) > 65_535:
        raise CairnError(f"--listen {listen}: give an address and a port, as in {_DEFAULT_LISTEN}")
    asyncio.run(
        _serve(
            AuthorityService(
                _authority(robot), match[1], int(match[2]), tuple(name or ()), days, grace, line
            ),
        )
    )


async def _serve(service: Any) -> None:
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        loop.add_signal_handler(number, service.stop)
    line(f"the authority answers at {service.url}")
    await service.run()


@app.command("enroll")
def enroll_here(
    token: Annotated[
        str,
        typer.Argument(
            metavar="TOKEN",
            help="What `cairn security token` has printed; -: read it from standard input.",
        ),
    ],
) -> None:
    """Get an identity for this computer with a token; the private key is made here."""
    from cairn.security.enrollment import enroll
    from cairn.security.tokens import LONGEST_TOKEN

    _report_own(enroll(sys.stdin.readline(LONGEST_TOKEN + 2) if token == "-" else token))


@app.command("fetch")
def fetch(
    name: Annotated[
        str,
        typer.Argument(metavar="[NAME]", help="The identity to ask with, if there are several."),
    ] = "",
    robot: Robot = "",
) -> None:
    """Fetch the newest roster from the authority."""
    from cairn.security.enrollment import fetch_roster, read_url
    from cairn.security.identity import own_names

    folder = _folder(robot)
    names = own_names(folder)
    if not name and len(names) != 1:
        listed = ", ".join(names) or "none"
        raise CairnError(f"{folder.identities}: give the name of one identity; it has: {listed}")
    url = read_url(folder, "enroll this computer: cairn security enroll TOKEN")
    roster = fetch_roster(folder, name or names[0], url)
    line(f"roster of {roster.robot}: version {roster.version} of {_utc(roster.issued)} UTC")


def _folder(robot: str) -> RobotFolder:
    """Return the folder of a robot, by default of the only one that this computer knows."""
    if robot:
        return RobotFolder.of(robot)
    robots = known_robots()
    if not robots:
        raise CairnError(
            f"{security_folder()}: there are no certificates; make an authority (cairn security "
            "init), or enroll this computer (cairn security enroll)"
        )
    if len(robots) > 1:
        raise CairnError(
            f"{security_folder()}: it has several robots; give one by --robot: {', '.join(robots)}"
        )
    return RobotFolder.of(robots[0])


def _loaded(
    file: Path | None, overlay: list[Path] | None, set_: list[str] | None
) -> Deployment | None:
    """Return the deployment in a file, which runs on several machines; None without a file."""
    from cairn.deployment.load import load_deployment

    if file is None:
        if overlay or set_:
            raise CairnError("--overlay and --set change a deployment; give it by --deployment")
        return None
    found = load_deployment(file, overlay or (), set_ or (), import_plugins=False)
    if not found.machines:
        raise CairnError(
            f"{file}: it has no `machines`, so it runs on one computer; add them, or name the "
            "overlay that has them by --overlay"
        )
    return found


def _authority(robot: str) -> Authority:
    from cairn.security.authority import Authority

    return Authority(_folder(robot))


def _pairs(texts: list[str] | None, option: str) -> list[tuple[str, str]]:
    """Return the parts of NAME=VALUE; `CairnError` if one is missing or a name is repeated."""
    found = [text.partition("=") for text in texts or ()]
    for name, _, value in found:
        if not name or not value:
            raise CairnError(f"{option} {name}: give NAME=VALUE, such as base=192.168.1.10")
    names = [name for name, _, _ in found]
    if len(set(names)) < len(names):
        raise CairnError(f"{option}: a name is given twice: {', '.join(names)}")
    return [(name, value) for name, _, value in found]


def _role(name: str, text: str) -> str:
    try:
        return RoleName(text).value
    except ValueError:
        roles = ", ".join(RoleName)
        raise CairnError(f"--operator {name}: {text[:40]!r} is not a role; give {roles}") from None


def _row(entry: Entry, now: float) -> dict[str, Any]:
    return {
        "name": entry.name,
        "kind": entry.kind,
        "role": entry.role,
        "addresses": list(entry.addresses),
        "state": entry.state(now),
        "valid_until": _utc(entry.not_after),
        "days_left": max(0, round((entry.not_after - now) / 86_400)),
        "common_name": entry.common_name,
    }


def _order(entry: Entry) -> tuple[str, str, bool, int]:
    return entry.kind, entry.name, not entry.is_current, entry.not_after


def _described(entry: Entry) -> str:
    what = entry.role or ", ".join(entry.addresses)
    return f"{entry.kind} {entry.name} ({what}): valid until {_utc(entry.not_after)} UTC"


def _report_own(identity: Identity) -> None:
    line(_described(identity.entry))
    line(f"certificate: {identity.certificate}")
    line(f"key:         {identity.key}")
    line(f"authority:   {identity.ca}")


def _utc(seconds: float) -> str:
    return time.strftime("%Y-%m-%d %H:%M", time.gmtime(seconds))

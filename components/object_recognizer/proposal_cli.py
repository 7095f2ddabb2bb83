"""`cairn object proposals`, `accept` and `reject`: things that were found, but never taught."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import cv2
import typer

from cairn import CairnError
from cairn.client import connect as connect_to
from cairn.components.object_recognizer.object_cli import DEFAULT_MAP, MapFile, app
from cairn.components.object_recognizer.proposals import Proposals, accept
from cairn.system.files import replace_file
from cairn.terminal.options import DEFAULT_CONNECT, Connect, Domain, Json, RobotName
from cairn.terminal.output import line, note, print_json, show

_FINDER = "object_finder"
_LIMIT_S = 10.0
_COLUMNS = {
    "number": "number",
    "name": "name",
    "x": "x [m]",
    "y": "y [m]",
    "sd": "deviation [m]",
    "width": "width [m]",
    "height": "height [m]",
    "seen": "recognized",
}

Number = Annotated[int, typer.Argument(metavar="NUMBER", help="The proposal's number.")]
File = Annotated[
    Path | None,
    typer.Option(
        "--file",
        metavar="PROPOSALS",
        help="The proposals_file of a robot that is off, instead of a running robot.",
    ),
]


@app.command("proposals")
def list_proposals(
    out: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Write a picture of each, NUMBER.png.")
    ] = None,
    file: File = None,
    json: Json = False,
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
) -> None:
    """List the things that the robot proposes as new landmarks."""
    if file is not None:
        waiting = _read(file).waiting
        rows = [one.describe() for one in waiting]
        pictures = {
            one.model.object_id: cv2.imencode(".png", one.model.views[0].picture)[1].tobytes()
            for one in waiting
        }
    else:
        rows = _request("proposals", {}, connect, domain, robot)["proposals"]
        pictures = {}
        if out is not None:
            for row in rows:
                arguments = {"number": row["number"]}
                answer = _request("picture", arguments, connect, domain, robot)
                pictures[row["number"]] = base64.b64decode(answer["png"])
    if out is not None:
        out.mkdir(exist_ok=True)
        for number, png in pictures.items():
            replace_file(out / f"{number}.png", png)
    show(rows, _COLUMNS, as_json=json, nothing="nothing is proposed")


@app.command("accept")
def accept_proposal(
    number: Number,
    name: Annotated[
        str | None, typer.Option(help="Its name as an object, instead of that of the proposal.")
    ] = None,
    file: File = None,
    map_file: MapFile = None,
    json: Json = False,
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
) -> None:
    """Make an object of a proposed thing; robots recognize it about a second later.

    With --file, it goes into --map.
    """
    if file is not None:
        proposals = _read(file)
        path = map_file or DEFAULT_MAP
        model = accept(proposals.waiting_one(number), name, path)
        proposals.remove(number)
        proposals.save()
        answer = {"object_id": model.object_id, "name": model.name, "map": str(path)}
    else:
        arguments = {"number": number, **({} if name is None else {"name": name})}
        answer = _request("accept", arguments, connect, domain, robot)
    if json:
        print_json(answer)
    else:
        line(f"{answer['name']} is object {answer['object_id']} of {answer['map']}")


@app.command("reject")
def reject_proposal(
    number: Number,
    file: File = None,
    json: Json = False,
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
) -> None:
    """Reject a proposed thing: it is not proposed again."""
    if file is not None:
        proposals = _read(file)
        proposals.reject(number)
        proposals.save()
        answer = {"saved": True}
    else:
        answer = _request("reject", {"number": number}, connect, domain, robot)
    if json:
        print_json(answer)
    else:
        line(f"proposal {number} is rejected")
    if not answer["saved"]:
        note("it is not saved yet, and a restart would lose it: `cairn ps` has the reason")


def _read(file: Path) -> Proposals:
    if not file.exists():
        raise CairnError(f"{file}: no such file; give the proposals_file of an object_finder")
    return Proposals(file)


def _request(verb: str, arguments: Mapping[str, Any], connect: str, domain: int, robot: str) -> Any:
    missing = "it proposes things; start the robot with `--overlay find_objects`"
    with connect_to(connect, domain, robot, notify=note) as client:
        return client.request_plugin(_FINDER, verb, arguments, missing=missing, timeout_s=_LIMIT_S)

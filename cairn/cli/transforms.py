"""`cairn tf`: the tree of frames of a running robot, and the transform between two of them."""

from __future__ import annotations

import json as json_module
import time
from collections.abc import Iterator, Mapping
from typing import Annotated, Any

import typer
import yaml

from cairn.bus.codec import to_plain
from cairn.client import TransformListener
from cairn.client import connect as connect_to
from cairn.schemas.builtin_interfaces import from_ns
from cairn.schemas.message import InvalidMessage
from cairn.system.clock import SECOND
from cairn.terminal import completion
from cairn.terminal.options import DEFAULT_CONNECT, Connect, Domain, Json, RobotName
from cairn.terminal.output import line, note, show
from cairn.tf import FrameInfo, Transform

_MAX_RATE_HZ = 1000.0
_DEEPEST_INDENT = 30  # levels; deeper frames are not indented any further
_DIGITS = 6
_COLUMNS = {
    "tree": "frame",
    "kind": "transform",
    "rate_hz": "Hz",
    "age_s": "age s",
    "publisher_name": "publisher",
}
_MOST_ROOTS = 10  # that a note lists

tf = typer.Typer(help="Show the tree of frames; print transforms.")
Wait = Annotated[
    float, typer.Option(min=0.1, help="Give up after this time without the transform [s].")
]


@tf.command("tree")
def show_tree(
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
    seconds: Annotated[
        float, typer.Option(min=0.1, max=60.0, help="How long to collect transforms [s].")
    ] = 2.0,
    wait: Annotated[
        float, typer.Option(min=0.1, help="Give up after this time without a transform [s].")
    ] = 10.0,
    json: Json = False,
) -> None:
    """Print the tree of frames with the publisher, rate and age of each transform.

    The age is that of the newest transform, in the robot's time.
    """
    problems: list[str] = []
    with (
        connect_to(connect, domain, robot) as client,
        client.transforms(max(10.0, seconds), on_problem=problems.append) as transforms,
    ):
        transforms.await_transforms(wait)
        time.sleep(seconds)
        frames = transforms.buffer.frames()
        now = transforms.now_ns()
    rows = [_row(frames[name], drawn, depth, now) for name, drawn, depth in _drawn(frames)]
    for row in rows if json else ():
        del row["tree"], row["kind"], row["publisher_name"]
    show(rows, _COLUMNS, as_json=json)
    roots = [name for name, one in frames.items() if one.parent is None]
    if len(roots) > 1:
        more = f" and {len(roots) - _MOST_ROOTS} more" if len(roots) > _MOST_ROOTS else ""
        note(
            f"there are {len(roots)} trees: no transform connects "
            f"{', '.join(roots[:_MOST_ROOTS])}{more}"
        )
    for problem in problems:
        note(problem)


@tf.command("echo")
def echo_transform(
    target: Annotated[
        str,
        typer.Argument(
            help="The frame in which the pose is given.",
            metavar="TARGET",
            autocompletion=completion.frames,
        ),
    ],
    source: Annotated[
        str,
        typer.Argument(
            help="The frame whose pose it is.",
            metavar="SOURCE",
            autocompletion=completion.frames,
        ),
    ],
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
    rate: Annotated[
        float, typer.Option(min=0.001, max=_MAX_RATE_HZ, help="How often to print [Hz].")
    ] = 1.0,
    once: Annotated[bool, typer.Option("--once", help="Print it once.")] = False,
    wait: Wait = 10.0,
    json: Annotated[bool, typer.Option("--json", help="Print one line of JSON each.")] = False,
) -> None:
    """Print the newest transform TARGET <- SOURCE: the pose of SOURCE in TARGET.

    Translation in meters, rotation as a quaternion and as roll, pitch and yaw about the fixed axes
    of TARGET, until Ctrl-C.
    """
    with connect_to(connect, domain, robot) as client, client.transforms(on_problem=note) as known:
        printed, began = 0, time.monotonic()
        while not (once and printed):
            time.sleep(max(0.0, began + printed / rate - time.monotonic()))
            value = _value(known, target, source, wait)
            if json:
                line(json_module.dumps(value))
            else:
                line(_document(value))
            printed += 1


def _value(known: TransformListener, target: str, source: str, wait_s: float) -> dict[str, Any]:
    """Return the newest transform as plain values; wait for it for some time [s]."""
    transform = known.lookup(target, source, timeout_s=wait_s)
    stamp = known.buffer.newest_common_time(target, source)
    if stamp is not None:
        transform = known.buffer.lookup(target, source, stamp)
    return {
        "target": target,
        "source": source,
        "stamp": None if stamp is None else _plain_stamp(stamp),
        "age_s": None if stamp is None else (known.now_ns() - stamp) / SECOND,
        **_plain(transform),
    }


def _plain(transform: Transform) -> dict[str, Any]:
    angles = transform.roll_pitch_yaw()
    return {
        "translation": dict(zip("xyz", transform.translation, strict=True)),
        "rotation": dict(zip("xyzw", transform.rotation, strict=True)),
        "roll_pitch_yaw": dict(zip(("roll", "pitch", "yaw"), angles, strict=True)),
    }


def _plain_stamp(stamp: int) -> Any:
    try:
        return to_plain(from_ns(stamp))
    except InvalidMessage:
        return None


def _document(value: Mapping[str, Any]) -> str:
    rounded = {
        key: round(one, _DIGITS)
        if isinstance(one, float)
        else {name: round(number, _DIGITS) for name, number in one.items()}
        if isinstance(one, dict)
        else one
        for key, one in value.items()
    }
    return yaml.safe_dump(rounded, sort_keys=False, default_flow_style=None) + "---"


def _drawn(frames: Mapping[str, FrameInfo]) -> Iterator[tuple[str, str, int]]:
    """Yield each frame's name, its name with the lines of the tree, and its depth."""
    children: dict[str, list[str]] = {}
    for name, one in frames.items():
        if one.parent is not None:
            children.setdefault(one.parent, []).append(name)
    left = dict.fromkeys(frames)
    # Frames of a loop have no root above them: the first of them by name stands in for it.
    starts = [name for name, one in frames.items() if one.parent is None]
    for start in (*starts, *frames):
        waiting = [(start, "", "", 0)]
        while waiting:
            name, lead, indent, depth = waiting.pop()
            if name not in left:
                continue
            del left[name]
            yield name, f"{lead}{name}", depth
            below = children.get(name, [])
            for number, child in enumerate(reversed(below)):
                if depth < _DEEPEST_INDENT:
                    is_last = number == 0
                    branch, space = ("└── ", "    ") if is_last else ("├── ", "│   ")
                    waiting.append((child, indent + branch, indent + space, depth + 1))
                else:
                    waiting.append((child, lead, indent, depth + 1))


def _row(frame: FrameInfo, drawn: str, depth: int, now: int) -> dict[str, Any]:
    is_root = frame.parent is None
    kind = "" if is_root else "static" if frame.is_static else "changing"
    rate = frame.rate_hz
    return {
        "frame": frame.name,
        "tree": drawn,
        "parent": frame.parent,
        "depth": depth,
        "static": None if is_root else frame.is_static,
        "kind": kind,
        "transforms": frame.transforms,
        "rate_hz": None if rate is None else round(rate, 3),
        "age_s": None if frame.newest_ns is None else round((now - frame.newest_ns) / SECOND, 3),
        "publisher": frame.publisher or None,
        "publisher_name": frame.publisher.rpartition("/")[2],
    }

"""`cairn recording info|cut|merge|export`: what a recording holds, and tools on it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import Annotated, Any, Final, Literal, NamedTuple

import typer

from cairn.errors import RecordingError
from cairn.limits.files import megabytes
from cairn.recording.mcap_file import Progress, RecordedChannel
from cairn.recording.reader import McapRecording
from cairn.recording.topics import TopicPatterns
from cairn.system.clock import SECOND
from cairn.terminal.output import line, note, print_json, show

_MOST_SHOWN: Final = 1_000  # topics: a table of more takes long
_LONGEST_SHOWN: Final = 2_000  # characters
_COLUMNS: Final = {
    "topic": "topic",
    "type": "type",
    "publisher": "publisher",
    "count": "count",
    "rate_hz": "rate [Hz]",
    "latched": "latched",
}

Format = Literal["csv", "parquet", "tum", "png", "jpeg"]
Recordings = Annotated[
    list[Path],
    typer.Argument(metavar="FILE...", help="MCAP files of one recording, or a folder with them."),
]
Recorded = Annotated[
    Path, typer.Argument(metavar="FILE", help="MCAP file, or a folder with the files of one run.")
]
Start = Annotated[
    str | None,
    typer.Option(metavar="TIME", help="From this time on: seconds after the start, or since 1970."),
]
End = Annotated[
    str | None, typer.Option(metavar="TIME", help="Up to this time, given in the same way.")
]
Topics = Annotated[
    list[str] | None,
    typer.Option(
        "--topic",
        metavar="TOPIC",
        help="Only this topic, such as `pose` or `/robot/pose`; * stands for any characters, ** "
        "for any levels. May be repeated.",
    ),
]
Exclude = Annotated[
    list[str] | None,
    typer.Option("--exclude", metavar="TOPIC", help="Not this topic. May be repeated."),
]
Force = Annotated[bool, typer.Option("--force", help="Replace existing files.")]


class Details(NamedTuple):
    """What a caller of `info` adds: `values` for JSON, `lines` to print, and `notes`."""

    values: dict[str, Any]
    lines: list[str]
    notes: list[str]


def info(
    file: Path, as_json: bool, details: Callable[[McapRecording], Details] | None = None
) -> None:
    """Print what a recording holds: span, topics, attachments, and what could not be read.

    `details` returns more that is shown of an open recording.
    """
    with _opened(file) as recording:
        more = Details({}, [], []) if details is None else details(recording)
        contents = contents_of(recording)
    contents |= more.values
    contents["notes"] = [*contents["notes"], *(f"{file}: {text}" for text in more.notes)]
    if as_json:
        print_json(contents)
        return
    line(f"files: {', '.join(contents['files'])} ({megabytes(contents['bytes'])} MB)")
    if contents["messages"]:
        line(f"time: {contents['start']} to {contents['end']}, {contents['span_s']:.3f} s")
    topics = contents["topics"]
    rows = [{key: _shown(value) for key, value in one.items()} for one in topics[:_MOST_SHOWN]]
    show(rows, _COLUMNS, as_json=False, nothing="no topic was recorded")
    if len(topics) > _MOST_SHOWN:
        line(f"and {len(topics) - _MOST_SHOWN:,} more: --json prints all")
    if contents["attachments"]:
        parts = [f"{one['name']} ({one['bytes']:,} bytes)" for one in contents["attachments"]]
        line(_shown(f"attachments: {', '.join(parts[:_MOST_SHOWN])}"))
    for name, values in contents["metadata"].items():
        line(_shown(f"{name}: {', '.join(f'{key} {value}' for key, value in values.items())}"))
    for text in more.lines:
        line(_shown(text))
    for text in contents["notes"]:
        note(_shown(text))


def _shown(value: Any) -> Any:
    """Return a text of a file as one line of limited length; other values as they are."""
    if not isinstance(value, str):
        return value
    text = " ".join(value.splitlines())
    return text if len(text) <= _LONGEST_SHOWN else f"{text[:_LONGEST_SHOWN]}..."


def contents_of(recording: McapRecording) -> dict[str, Any]:
    """Return files, span, topics, attachments, metadata and notes of a recording."""
    span = (recording.end_ns - recording.start_ns) / SECOND
    messages = recording.counts.total()
    return {
        "files": [str(file) for file in recording.files],
        "bytes": recording.size,
        "start": _iso(recording.start_ns) if messages else None,
        "end": _iso(recording.end_ns) if messages else None,
        "start_ns": recording.start_ns if messages else None,
        "end_ns": recording.end_ns if messages else None,
        "span_s": span,
        "messages": messages,
        "topics": [
            {
                "topic": one.topic,
                "type": one.type,
                "publisher": one.node or one.gid,
                "count": recording.counts[one],
                "rate_hz": round(recording.counts[one] / span, 3) if span > 0 else None,
                "latched": "yes" if one.latched else "",
                "type_hash": one.type_hash,
                "gid": one.gid,
                "encoding": one.encoding,
            }
            for one in recording.channels
        ],
        "attachments": [
            {"name": one.name, "bytes": one.size, "media_type": one.media_type}
            for one in recording.attachments
        ],
        "metadata": recording.metadata,
        "notes": recording.notes,
    }


def cut(
    file: Recorded,
    out: Annotated[Path, typer.Argument(metavar="OUT", help="MCAP file to write.")],
    start: Start = None,
    end: End = None,
    topic: Topics = None,
    exclude: Exclude = None,
    force: Force = False,
) -> None:
    """Write a part of a recording into a new file, by time or by topics.

    Latched topics keep what they held at the start; attachments are copied.
    """
    _rewrite(file, out, start, end, topic, exclude, force)


def merge(
    files: Recordings,
    out: Annotated[Path, typer.Option("--out", "-o", metavar="OUT", help="MCAP file to write.")],
    topic: Topics = None,
    exclude: Exclude = None,
    force: Force = False,
) -> None:
    """Write several files into one, in order of time.

    Latched messages that the recorder repeated at the start of each file are written once.
    """
    _rewrite(files, out, None, None, topic, exclude, force)


def export(
    file: Recorded,
    format_: Annotated[
        Format, typer.Option("--format", "-f", help="What to write: see the first lines.")
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", "-o", metavar="FOLDER", help="Folder to write to.", show_default="FILE_FORMAT"
        ),
    ] = None,
    start: Start = None,
    end: End = None,
    topic: Topics = None,
    exclude: Exclude = None,
    force: Force = False,
) -> None:
    """Export messages: csv, parquet, tum (trajectories of poses), png or jpeg (images).

    Each topic becomes a file such as `robot.pose.csv`, or a folder of images that are named by
    their stamps.
    """
    from cairn.recording.export import export_recording  # imports OpenCV

    with _opened(file) as recording:
        start_ns, end_ns = _span(recording, start, end)
        channels = _chosen(recording, topic, exclude)
        folder = out or Path(f"{file.stem}_{format_}")
        with _progress("exporting") as progress:
            exported = export_recording(
                recording,
                format_,
                folder,
                channels,
                start_ns,
                end_ns,
                named=bool(topic),
                force=force,
                progress=progress,
            )
        for path, count in sorted(exported.files.items()):
            line(f"{path}: {count:,} messages")
        for text in [*exported.notes, *recording.notes]:
            note(text)


def _rewrite(
    files: Path | Sequence[Path],
    out: Path,
    start: str | None,
    end: str | None,
    topic: list[str] | None,
    exclude: list[str] | None,
    force: bool,
) -> None:
    from cairn.recording.rewrite import rewrite

    if out.exists() and not force:
        raise RecordingError(f"{out}: exists; give another name, or replace it with --force")
    with _opened(files) as recording:
        start_ns, end_ns = _span(recording, start, end)
        channels = _chosen(recording, topic, exclude) if topic or exclude else None
        with _progress("writing") as progress:
            count = rewrite(recording, out, start_ns, end_ns, channels, progress)
        line(f"{out}: {count:,} messages, {megabytes(out.stat().st_size)} MB")
        for text in recording.notes:
            note(text)


@contextmanager
def _opened(files: Path | Sequence[Path]) -> Iterator[McapRecording]:
    with _progress("reading") as progress:
        recording = McapRecording(files, progress)
    with recording:
        yield recording


def _span(recording: McapRecording, start: str | None, end: str | None) -> tuple[int, int]:
    start_ns = 0 if start is None else _time(recording, "start", start)
    end_ns = 2**64 if end is None else _time(recording, "end", end)
    if start_ns > end_ns:
        raise RecordingError(f"--start {start} is after --end {end}; exchange them")
    return start_ns, end_ns


def _time(recording: McapRecording, option: str, text: str) -> int:
    """Return a time [ns] that is given in seconds after the start or since 1970."""
    try:
        value = Decimal(text)
        if not (value.is_finite() and 0 <= value < 10**10):
            raise InvalidOperation
    except InvalidOperation as error:
        raise RecordingError(
            f"--{option} {text[:40]!r} is not a time; give seconds after the start, such as 12.5, "
            "or since 1970"
        ) from error
    return recording.time_ns(value)


def _chosen(
    recording: McapRecording, topic: list[str] | None, exclude: list[str] | None
) -> list[RecordedChannel]:
    """Return the channels of the topics that are wanted; raise `RecordingError` without any."""
    chosen = recording.channels
    for pattern in topic or ():
        if not any(_patterns([pattern]).match(one.topic) for one in chosen):
            raise RecordingError(
                f"{recording.files[0]}: no topic matches {pattern}; its topics are "
                f"{', '.join(sorted({one.topic for one in chosen})[:50]) or 'none'}"
            )
    if topic:
        wanted = _patterns(topic)
        chosen = [one for one in chosen if wanted.match(one.topic)]
    if exclude:
        unwanted = _patterns(exclude)
        chosen = [one for one in chosen if not unwanted.match(one.topic)]
    return chosen


def _patterns(topics: list[str]) -> TopicPatterns:
    """Return the topics of any robot, and of recordings without names of robots."""
    return TopicPatterns([*topics, *(f"/{one}" for one in topics if not one.startswith("/"))])


@contextmanager
def _progress(title: str) -> Iterator[Progress]:
    """Show on a terminal how much is done."""
    from rich.console import Console
    from rich.progress import Progress as Bar  # takes 30 ms

    console = Console(stderr=True)
    with Bar(console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(title, total=None)

        def update(done: int, total: int) -> None:
            bar.update(task, completed=done, total=total)

        yield update


def _iso(time_ns: int) -> str:
    seconds, rest = divmod(time_ns, SECOND)
    try:
        moment = datetime.fromtimestamp(seconds, UTC)
    except (OverflowError, ValueError, OSError):
        return f"{time_ns} ns"
    return f"{moment:%Y-%m-%dT%H:%M:%S}.{rest:09d}Z"

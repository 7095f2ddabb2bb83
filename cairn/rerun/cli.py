"""`cairn rerun`: re-run components of a recording, and compare what they publish."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from cairn.errors import CairnError
from cairn.recording.reader import McapRecording
from cairn.rerun.excerpt import save_test
from cairn.rerun.result import RerunResult
from cairn.rerun.run import chosen_starts, starts_in
from cairn.rerun.worker import rerun_in_processes
from cairn.system.clock import SECOND
from cairn.terminal.output import line, note, print_json


def rerun(
    files: Annotated[
        list[Path],
        typer.Argument(metavar="FILE...", help="MCAP files of one recording, or a folder."),
    ],
    component: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Re-run this component. May be repeated."),
    ] = None,
    until: Annotated[
        float | None,
        typer.Option(
            metavar="TIME",
            help="Make the calls before this time only [s]: since the start of the recording, or "
            "since 1970.",
        ),
    ] = None,
    save_test_in: Annotated[
        Path | None,
        typer.Option(
            "--save-test",
            metavar="FOLDER",
            help="Write a test that re-runs the component until the first difference, or until "
            "TIME, and what it needs of the recording.",
        ),
    ] = None,
    time_limit: Annotated[
        float, typer.Option(metavar="S", min=1, max=1e6, help="Longest time for one component [s].")
    ] = 600.0,
    force: Annotated[bool, typer.Option("--force", help="Replace existing files.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Re-run components exactly as recorded, and compare what they publish with the recording.

    By default all that publish something and can be re-run. Exit status 0: all is equal, 1: not.
    """
    names = component or []
    if save_test_in is not None and len(names) != 1:
        raise CairnError("--save-test: choose one component with --component NAME")
    with McapRecording(files) as recording:
        nodes = {one.node for one in recording.channels}
        starts = chosen_starts(starts_in(recording), names, nodes)
        if not starts:
            raise CairnError(
                f"{files[0]}: nothing can be re-run: it has no call log; record with `cairn up "
                "--record`, by a component `recorder` of all topics, or with `call_log: true`"
            )
        until_ns = None if until is None else recording.time_ns(until)
        results = rerun_in_processes(recording.files, starts, until_ns, time_limit)
        if as_json:
            print_json([_plain(one) for one in results])
        else:
            _print(results, recording.start_ns)
        if save_test_in is not None:
            start, result = starts[0], results[0]
            if until_ns is None and result.first is not None:
                until_ns = result.first.call_ns + 1
            saved = save_test(recording, start, save_test_in, until_ns, files[0].name, force=force)
            for file in saved:
                note(f"wrote {file}")
    if not all(one.equal for one in results):
        raise typer.Exit(1)


def _print(results: Sequence[RerunResult], start_ns: int) -> None:
    for one in results:
        which = (
            f"{one.component} (start {one.incarnation})" if one.incarnation > 1 else one.component
        )
        compared = sum(topic.compared for topic in one.topics.values())
        differing = sum(topic.differing for topic in one.topics.values())
        calls = f"{one.calls:,} calls, {compared:,} messages compared"
        if one.equal:
            line(f"{which}: equal: {calls}")
        elif one.first is not None:
            line(f"{which}: DIFFERENT: {calls}, {differing:,} differ")
            first = one.first
            time_s = (first.time_ns - start_ns) / SECOND
            topic = f"{first.topic}: " if first.topic else ""
            line(f"  first difference at {time_s:.6f} s, in {first.call}: {topic}{first.what}")
            for name, topic_result in one.topics.items():
                if topic_result.differing:
                    parts = ", ".join(
                        f"{count:,} {word}" for word, count in asdict(topic_result).items() if count
                    )
                    line(f"  {name}: {parts.replace('_', ' ')}")
        if one.incomplete:
            line(f"{which}: not re-run completely, {calls}: {one.incomplete}")
        lost = sum(topic.not_recorded for topic in one.topics.values())
        if lost:
            line(f"  {lost:,} of its messages are not in the recording and were not compared")
        for text in one.notes if not one.equal else ():
            line(f"  the re-run {text}")


def _plain(result: RerunResult) -> dict[str, Any]:
    return {**asdict(result), "equal": result.equal}

"""Re-runs components of a recording: which starts it has, and one re-run in this process."""

import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from cairn.bus.codec import Codec
from cairn.errors import CairnError, RecordingError
from cairn.recording.mcap_file import RecordedChannel
from cairn.recording.reader import McapRecording
from cairn.rerun.call_logs import ComponentStart, component_starts
from cairn.rerun.engine import Rerun
from cairn.rerun.files import ATTACHED, with_files
from cairn.rerun.streamed_messages import StreamedMessages, needed_messages
from cairn.schemas.cairn_msgs import CallBatch
from cairn.schemas.message import InvalidMessage, type_name

CALL_BATCH: Final = type_name(CallBatch)
EXCERPT_RECORD: Final = "cairn_rerun"
"""Metadata record of an excerpt: `until_ns`, the time before which its calls were made."""


def starts_in(recording: McapRecording) -> list[ComponentStart]:
    """Return the starts of components with their call logs, in order of time."""
    channels = [one for one in recording.channels if one.type == CALL_BATCH]
    return component_starts(_batches(recording, channels)) if channels else []


@contextmanager
def prepared_rerun(
    recording: McapRecording,
    start: ComponentStart,
    until_ns: int | None = None,
    *,
    stop_at_difference: bool = False,
    on_call: Callable[[int, str], object] = lambda _time_ns, _name: None,
) -> Iterator[Rerun]:
    """Provide the re-run of a start, with its files in a folder that is removed afterwards.

    See `Rerun` for the arguments. Raises `CairnError` with the reason if the component cannot be
    re-run.
    """
    needed = needed_messages(start)
    if needed.has_foreign_calls:
        raise CairnError(
            f"{start.component}: cannot be re-run: threads of its own have called it, as those of "
            "a driver do, and what they measured is not in the recording; re-run the components "
            "that read its topics"
        )
    if until_ns is None:
        until_ns = _recorded_end(recording)
    attached = {one.name.split("/")[1]: one for one in recording.attachments if _is_input(one.name)}

    def content(digest: str) -> bytes | None:
        found = attached.get(digest)
        return None if found is None else recording.read_attachment(found)

    with tempfile.TemporaryDirectory(prefix="cairn-rerun-") as folder:
        info, missing = with_files(start.info(), Path(folder), content)
        if missing:
            raise CairnError(
                f"{start.component}: cannot be re-run exactly: {missing[0]}"
                + (f", and {len(missing) - 1} more" if len(missing) > 1 else "")
            )
        messages = StreamedMessages(recording, needed)
        yield Rerun(start, info, messages, until_ns, stop_at_difference, on_call)


def chosen_starts(
    starts: Iterable[ComponentStart], components: Iterable[str], nodes: Iterable[str] = ()
) -> list[ComponentStart]:
    """Return the starts of the named components; of those that publish something without names.

    Raises `CairnError` for a component without a call log; `nodes` are those of the recording.
    """
    known = list(starts)
    names = list(components)
    for name in names:
        if not any(one.component == name for one in known):
            choice = ", ".join(dict.fromkeys(one.component for one in known)) or "none"
            why = (
                "the recording has no call log of it: it drives a device, or the deployment on "
                "its machine has no `call_log: true`"
                if any(node.rsplit("/", 1)[-1] == name for node in nodes)
                else "it is not in the recording"
            )
            raise CairnError(f"{name}: cannot be re-run: {why}; with a call log: {choice}")
    if names:
        return [one for one in known if one.component in names]
    chosen = []
    for one in known:
        needed = needed_messages(one)
        if needed.publishes and not needed.has_foreign_calls:
            chosen.append(one)
    return chosen


def _recorded_end(recording: McapRecording) -> int | None:
    text = recording.metadata.get(EXCERPT_RECORD, {}).get("until_ns", "")
    return int(text) if text.isascii() and text.isdigit() else None


def _batches(recording: McapRecording, channels: list[RecordedChannel]) -> Iterator[CallBatch]:
    codec = Codec()
    for message in recording.messages(channels=channels):
        try:
            yield codec.decode(CallBatch, message.data)
        except InvalidMessage as error:
            raise RecordingError(f"{message.channel.topic}: invalid call log: {error}") from error


def _is_input(name: str) -> bool:
    return name.startswith(ATTACHED) and name.count("/") == 2

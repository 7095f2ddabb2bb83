"""Writes what the re-run of one component needs, as a small recording and a test beside it."""

import re
from pathlib import Path
from typing import Final

from cairn.bus.bus import MessageId
from cairn.bus.codec import Codec
from cairn.errors import CairnError
from cairn.recording.mcap_file import RecordedMessage
from cairn.recording.reader import McapRecording
from cairn.recording.rewrite import rewrite
from cairn.rerun.call_logs import ComponentStart
from cairn.rerun.files import ATTACHED
from cairn.rerun.run import CALL_BATCH, EXCERPT_RECORD
from cairn.rerun.streamed_messages import add_uses
from cairn.runtime.input_files import LONGEST_FILE, file_digest
from cairn.schemas.cairn_msgs import CallBatch
from cairn.system.files import explained

_TEST: Final = '''\
"""{subject} publishes the same as recorded in {source}, for the same calls.

Written by `cairn rerun --save-test`. A change of behavior makes it fail with the first difference.
"""

from pathlib import Path

from cairn.testing.rerun import assert_rerun_equal


def test_{function}_publishes_what_was_recorded() -> None:
    assert_rerun_equal(Path(__file__).with_name("{recording}"))
'''


def save_test(
    recording: McapRecording,
    start: ComponentStart,
    folder: Path,
    until_ns: int | None,
    source: str,
    *,
    force: bool = False,
) -> tuple[Path, Path]:
    """Write the excerpt of a start until `until_ns` [ns], and the test; return their paths.

    Raises `CairnError` if they exist, unless `force`, or cannot be written.
    """
    name = re.sub(r"\W", "_", f"{start.component}_{Path(source).stem}")
    excerpt, test = folder / f"{name}.mcap", folder / f"test_{name}.py"
    for file in (excerpt, test):
        if file.exists() and not force:
            raise CairnError(f"{file}: exists already; give another folder, or --force")
    used, records = _used(start, until_ns)
    gids = {one.gid.hex() for one in used}
    channels = [one for one in recording.channels if one.gid in gids or one.type == CALL_BATCH]
    codec = Codec()

    def wanted(message: RecordedMessage) -> bool:
        if message.channel.type == CALL_BATCH:
            return start.contains(codec.decode(CallBatch, message.data), records)
        return MessageId(bytes.fromhex(message.channel.gid), message.sequence) in used

    marks = {} if until_ns is None else {"until_ns": str(until_ns)}
    with explained(f"{folder}: cannot be written"):
        folder.mkdir(parents=True, exist_ok=True)
        rewrite(
            recording, excerpt, channels=channels, wanted=wanted,
            attachments=_attachments(recording, start),
            metadata={EXCERPT_RECORD: {"component": start.component, **marks}},
        )  # fmt: skip
        test.write_text(
            _TEST.format(
                subject=_plain(start.component),
                source=_plain(source),
                function=name,
                recording=excerpt.name,
            )
        )
    return excerpt, test


def _plain(name: str) -> str:
    """Return a name without what could end the text in which it is written."""
    return re.sub(r"[^\w./ -]", "_", name)


def _used(start: ComponentStart, until_ns: int | None) -> tuple[set[MessageId], int]:
    """Return the messages that the calls before `until_ns` use, and the number of records."""
    used: set[MessageId] = set()
    gids: dict[str, bytes] = {}
    records = 0
    for call in start.calls():
        if until_ns is not None and call.time_ns >= until_ns:
            break
        records += 1 + len(call.events)
        add_uses([call.record, *call.events], used, gids)
    return used, records


def _attachments(recording: McapRecording, start: ComponentStart) -> dict[str, bytes]:
    """Return the attachments of the excerpt: the input files of the component, and short ones."""
    info = start.info()
    digests = {file.digest for file in info.files}
    attached = {}
    for one in recording.attachments:
        if not one.name.startswith(ATTACHED) or one.name.split("/")[1] in digests:
            attached[one.name] = recording.read_attachment(one)
    there = {name.split("/")[1] for name in attached if name.startswith(ATTACHED)}
    for file in info.files:
        path = Path(file.path)
        if file.digest and file.digest not in there:
            try:
                if path.stat().st_size <= LONGEST_FILE and file_digest(path) == file.digest:
                    attached[f"{ATTACHED}{file.digest}/{path.name}"] = path.read_bytes()
            except OSError:
                continue  # the test says that it is missing
    return attached

"""The commands of docs/how-to/record.md, at a robot that records itself."""

import json
import re
import shlex
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from cairn.recording.mcap_file import McapFile
from cairn.testing.launching import Launching
from tests.commands import cairn

pytestmark = pytest.mark.processes

PAGE = "docs/how-to/record.md"
STATE_AFTER = {"split": "recording_2.mcap", "pause": "paused:", "resume": "recording:"}
"""What `cairn recorder` prints of the state that it has brought about."""


@pytest.mark.accuracy
def test_commands_of_the_page_record_a_running_robot(
    launch: Launching,
    page_blocks: Callable[[str], Any],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    commands = [
        shlex.split(line, comments=True)[1:]
        for block in page_blocks(PAGE)
        if block.language == "sh"
        for line in block.text.splitlines()
    ]
    (output,) = [one.text for one in page_blocks(PAGE) if one.language == "text"]
    shown = re.sub(r"\\?\d+", r"\\d+", re.escape(output))  # with any numbers
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("CAIRN_CONNECT", "")

    run = launch("components: {beacon: {plugin: test_beacon}}", "--record")
    run.await_line("child active: beacon")
    called: dict[str, int] = {}
    for words in [one for one in commands if one[0] == "recorder"]:
        called[words[1]] = time.time_ns()
        answer = cairn(*words, connect=run.endpoint)
        needs_ring = words[1] == "trigger"
        assert (answer.code, "--last" in answer.err) == (int(needs_ring), needs_ring), words
        assert STATE_AFTER.get(words[1], "") in answer.out, answer.out
    for words in [one for one in commands if one[0] == "record"]:
        answer = cairn(*words, "--duration", "0.6", connect=run.endpoint)
        assert answer.code == 0, (words, answer.err)
        assert ("nothing was triggered" in answer.out) == ("--last" in words), answer.out
        if "drive.mcap" in words:
            # This robot has none of the topics that the page names.
            notes = re.sub(r"\w+ has no publisher so far.*\n", "", answer.err)
            assert re.fullmatch(shown, notes + answer.out), answer
    wrong = ["component_statu", "--last", "5", "--trigger", "component_status.restartz > 0"]
    answer = cairn("record", *wrong, connect=run.endpoint)
    assert answer.code == 1, answer
    assert (
        "component_statu has no publisher so far; did you mean /robot/component_status?"
        in answer.err
    )
    assert "cairn_msgs/msg/ComponentStatus has no number restartz" in answer.err
    assert run.stop() == 0

    with McapFile(max(tmp_path.glob("recording-*.mcap"))) as file:
        file.index()
        assert {one.topic for one in file.channels} >= {"/robot/component_status", "/rosout"}
        (deployment,) = [one for one in file.attachments if one.name == "deployment.json"]
        assert "beacon" in json.loads(file.read_attachment(deployment))["components"]
    published: dict[tuple[str, str], dict[int, int]] = {}  # time of each number, of each publisher
    for name in ("recording.mcap", "recording_2.mcap"):
        with McapFile(run.report / name) as file:
            assert not file.notes
            for message in file.messages(lambda _: True):
                of_publisher = (message.channel.topic, message.channel.gid)
                published.setdefault(of_publisher, {})[message.sequence] = message.publish_ns
    beacons = [some for (topic, _), some in published.items() if topic.endswith("component_status")]
    assert len(beacons) == 4  # root, recording, recorder, beacon
    resumed = called["trigger"]  # the next command after `resume`
    for times in beacons:
        for number, following in pairwise(sorted(times)):
            in_pause = times[number] < resumed and times[following] > called["pause"]
            assert following == number + 1 or in_pause, (number, following)


def test_settings_on_the_page_are_those_of_the_recorder(page_blocks: Callable[[str], Any]) -> None:
    from cairn.components.run_outputs.recorder import RecorderConfig

    (block,) = [one for one in page_blocks(PAGE) if one.language == "yaml"]
    named = {line.strip().partition(":")[0] for line in block.text.splitlines()[5:]}
    assert named <= set(RecorderConfig.model_fields)

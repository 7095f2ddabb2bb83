"""Errors of `cairn map build`: each names the file, what is wrong with it, and a remedy."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from cairn import SECOND
from tests.commands import cairn
from tests.components.replay_devices.test_ros_bag import (
    BEGIN,
    STORE,
    Messages,
    drive,
    header,
    odometry,
    of,
    ros2,
    scan,
)
from tests.wording import assert_words

pytestmark = pytest.mark.slow

DATA = Path(__file__).parents[3] / "data"
LOG = DATA / "slam" / "fr079_start.clf.gz"
AT = BEGIN * SECOND


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with recordings that give no map, a small one that does, and its map."""
    folder = tmp_path_factory.mktemp("inputs")
    image = of(
        STORE,
        "sensor_msgs/msg/Image",
        header=header(BEGIN, "camera"),
        height=2,
        width=2,
        encoding="mono8",
        is_bigendian=0,
        step=2,
        data=np.zeros(4, np.uint8),
    )
    two: Messages = [(f"/{robot}/scan", AT, scan(BEGIN)) for robot in "ab"]
    bags: dict[str, Messages] = {
        "scans": [("/scan", AT, scan(BEGIN))],
        "wheels": [("/odom", AT, odometry(BEGIN, 0.0))],
        "cameras": [("/camera/image", AT, image)],
        "two": two,
        "small": drive(20),
    }
    for name, messages in bags.items():
        ros2(folder / name, messages)
    (folder / "empty.mcap").touch()
    (folder / "none").mkdir()
    (folder / "text.txt").write_text("hello\n")
    with closing(sqlite3.connect(folder / "other.db")) as connection:
        connection.execute("CREATE TABLE graph (number INTEGER)")
    assert cairn("map", "build", str(folder / "small"), str(folder / "map")).code == 0
    return folder


@pytest.mark.parametrize(
    ("recording", "options", "words"),
    [
        ("nothing.bag", [], ("nothing.bag", "no such file or folder", "use")),
        ("empty.mcap", [], ("empty.mcap", "is an empty file", "record or copy it again")),
        ("none", [], ("none is not a recording", "it holds: nothing", "use")),
        ("text.txt", [], ("text.txt is not a recording", "hello", "use")),
        ("other.db", [], ("other.db", "a database, but not a ROS 2 bag", "Give a recording")),
        ("scans", [], ("scans", "no odometry", "--scan-only")),
        ("wheels", [], ("wheels", "no scans", "only odometry", "give a recording")),
        ("cameras", [], ("cameras", "no scans", "only images", "give a recording")),
        ("two", [], ("two", "/a/scan, /b/scan", "--scan")),
        ("small", ["--scan", "/c"], ("small", "/c is not a topic", "/scan")),
        ("small", ["--robot", "3"], ("small", "not an MRCLAM", "leave --robot out")),
        ("small", ["--scanner", "1,2"], ("--scanner 1,2", "X,Y,THETA, such as")),
        ("small", ["--scanner", "0,0,nan"], ("--scanner 0,0,nan", "radians", "correct")),
        ("small", ["--scanner", "0,0,90"], ("--scanner 0,0,90", "radians", "correct")),
        ("small", ["--scanner", "300,0,0"], ("--scanner 300,0,0", "5 m", "correct")),
        ("small", ["--extend", "no.graph"], ("no.graph: no such file", "give a graph")),
        ("small", ["--extend", "none"], ("none: is not a file", "give a graph")),
        ("small", ["--extend", "text.txt"], ("text.txt: not a graph", "give one")),
        ("small", ["--extend", "other.db"], ("other.db: not a graph", "give one")),
    ],
)
def test_unusable_recording_or_option_is_named_with_a_remedy(
    inputs: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    recording: str,
    options: list[str],
    words: tuple[str, ...],
) -> None:
    monkeypatch.chdir(inputs)
    answer = cairn("map", "build", recording, str(tmp_path / "new" / "map"), *options)

    assert answer.code == 1
    assert "\ncairn: " in f"\n{answer.err}"  # after notes on the recording
    assert_words(answer.err, *words)
    assert not (tmp_path / "new").exists()


def test_data_set_of_several_robots_names_those_that_it_has(tmp_path: Path) -> None:
    data = DATA / "mrclam" / "MRCLAM_Dataset6"
    answer = cairn("map", "build", str(data), str(tmp_path / "map"))

    assert answer.code == 1
    assert_words(answer.err, "several robots", "--robot", "2, 5")


@pytest.mark.parametrize(
    ("out", "words"),
    [
        ("none", ("none is a folder", "such as none/map")),
        (".", (". is a folder", "such as map")),
        ("text.txt/map", ("text.txt/map cannot be written", "text.txt is not a folder", "give")),
    ],
)
def test_name_that_cannot_be_written_is_refused_before_the_map_is_built(
    inputs: Path, monkeypatch: pytest.MonkeyPatch, out: str, words: tuple[str, ...]
) -> None:
    monkeypatch.chdir(inputs)
    before = sorted(inputs.rglob("*"))

    answer = cairn("map", "build", "no such recording", out)

    assert answer.code == 1
    assert_words(answer.err, *words)
    assert sorted(inputs.rglob("*")) == before


@pytest.mark.accuracy
def test_map_of_another_building_is_not_extended(
    inputs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The recording, of which the own map would be the larger one, does not replace it."""
    monkeypatch.chdir(inputs)
    out, graph = tmp_path / "both", inputs / "map.graph"

    answer = cairn("map", "build", str(LOG), str(out), "--extend", str(graph))

    assert answer.code == 1
    assert_words(answer.err, "no place of the map", "of one building", "without --extend")
    assert list(tmp_path.glob("both*")) == []

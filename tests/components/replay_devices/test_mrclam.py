"""MRCLAM data sets of any number and robot; damaged ones are rejected with file and line."""

import gzip
import shutil
from pathlib import Path

import numpy as np
import pytest

from cairn.components.replay_devices.mrclam import MrclamDataset
from cairn.errors import RecordingError
from tests.wording import words_in_order

pytestmark = pytest.mark.slow


@pytest.fixture
def copy(dataset: Path, tmp_path: Path) -> Path:
    """A data set with plain, short files of robot 2."""
    folder = tmp_path / "set"
    folder.mkdir()
    for name in ("Barcodes.dat", "Landmark_Groundtruth.dat"):
        shutil.copyfile(dataset / name, folder / name)
    for kind in ("Odometry", "Measurement", "Groundtruth"):
        text = gzip.decompress((dataset / f"Robot2_{kind}.dat.gz").read_bytes())
        lines = text.splitlines(keepends=True)[:60]
        (folder / f"Robot2_{kind}.dat").write_bytes(b"".join(lines))
    return folder


@pytest.mark.parametrize("robot", [2, 5])
def test_complete_recording_is_read(dataset: Path, robot: int) -> None:
    recording = MrclamDataset(dataset)

    odometry = recording.odometry(robot)
    sightings = recording.observations(robot)

    assert odometry.shape[1] == 3
    assert len(odometry) > 60_000
    assert np.all(np.diff(odometry[:, 0]) >= 0)
    assert len(sightings.time) > 4_000
    assert recording.truth(robot).shape[1] == 4
    assert {one.object_id for one in recording.landmarks()} == set(range(6, 21))
    assert recording.subjects()[63] == 6
    first, last = recording.span(robot)
    assert first == odometry[0, 0]
    assert 880 < last - first < 890


def test_windows_line_ends_comments_and_blank_lines_change_nothing(copy: Path) -> None:
    before = MrclamDataset(copy).odometry(2)
    path = copy / "Robot2_Odometry.dat"
    text = path.read_text().replace("\n", "\r\n")
    path.write_bytes((text + "\r\n# the end\r\n\r\n").encode())

    assert np.array_equal(MrclamDataset(copy).odometry(2), before)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("1248444189.9 0.1", "2 columns instead of 3"),
        ("1248444189.9 0.1 fast", "not a number"),
        ("1248444189.9 nan 0.1", "not a finite number"),
        ("1248444100.0 0.1 0.1", "time runs backwards, from 1248444190."),
    ],
)
def test_damaged_line_is_named(copy: Path, line: str, message: str) -> None:
    path = copy / "Robot2_Odometry.dat"
    path.write_text(path.read_text() + line + "\n")

    with pytest.raises(RecordingError) as refused:
        MrclamDataset(copy).odometry(2)

    assert f"{path}, line 61: {message}" in str(refused.value)
    assert "take a fresh copy" in str(refused.value)


def test_cut_off_gzip_file_is_named(dataset: Path, copy: Path) -> None:
    (copy / "Robot2_Odometry.dat").unlink()
    whole = (dataset / "Robot2_Odometry.dat.gz").read_bytes()
    (copy / "Robot2_Odometry.dat.gz").write_bytes(whole[: len(whole) // 2])

    with pytest.raises(
        RecordingError, match=r"Robot2_Odometry.dat.gz, line \d+: the compressed stream"
    ):
        MrclamDataset(copy).odometry(2)


@pytest.mark.parametrize("content", [b"", b"# only a comment\n"])
def test_empty_file_is_named(copy: Path, content: bytes) -> None:
    (copy / "Robot2_Measurement.dat").write_bytes(content)

    with pytest.raises(RecordingError, match=r"Robot2_Measurement.dat holds no record"):
        MrclamDataset(copy).observations(2)


def test_binary_file_is_rejected(copy: Path) -> None:
    (copy / "Barcodes.dat").write_bytes(b"\x89PNG\r\n\xff\xfe")

    with pytest.raises(RecordingError, match=r"Barcodes.dat, line 1: not a text file"):
        MrclamDataset(copy).subjects()


@pytest.mark.parametrize(
    ("name", "record", "message"),
    [
        ("Measurement", "1248444999.0 63 -1.0 0.1", r"range \[m\] is -1, not from 1e-06 to 10000"),
        ("Measurement", "1248444999.0 6.5 1.0 0.1", r"barcode 6.5 is not a whole number"),
        ("Measurement", "1248444999.0 1e300 1.0 0.1", r"barcode is 1e\+300, not from 0 to 1e\+06"),
        ("Measurement", "2000000000.0 63 1.0 0.1", r"\d+ s pass since the record before"),
        ("Measurement", "5000000000.0 63 1.0 0.1", r"time \[s\] is 5e\+09, not from 0 to"),
        ("Odometry", "1248448000.0 1e300 0.0", r"forward \[m/s\] is 1e\+300, not from -100 to 100"),
    ],
)
def test_impossible_number_is_rejected_with_its_line(
    copy: Path, name: str, record: str, message: str
) -> None:
    path = copy / f"Robot2_{name}.dat"
    text = path.read_text()
    path.write_text(f"{text}{record}\n")

    with pytest.raises(
        RecordingError, match=rf"{path.name}, line {text.count(chr(10)) + 1}: {message}"
    ):
        MrclamDataset(copy).span(2)


def test_files_of_different_runs_are_rejected(copy: Path) -> None:
    (copy / "Robot2_Measurement.dat").write_text("100.0 63 1.0 0.1\n")

    with pytest.raises(RecordingError, match=words_in_order("not from one run")):
        MrclamDataset(copy).span(2)


def test_missing_robot_or_folder_is_named_with_the_existing_files(
    copy: Path, tmp_path: Path
) -> None:
    with pytest.raises(RecordingError, match=r"neither Robot4_Odometry.dat nor .*Barcodes.dat"):
        MrclamDataset(copy).odometry(4)
    with pytest.raises(RecordingError, match="no such folder"):
        MrclamDataset(tmp_path / "nowhere").odometry(2)

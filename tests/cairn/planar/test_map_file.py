"""Grid maps are read and written as by map_server; invalid files are rejected by name."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from cairn import CairnError
from cairn.planar.grid import FREE, OCCUPIED, UNKNOWN, Frame, Grid
from cairn.planar.map_file import Mode, read_map, write_map
from tests.disk import room_for
from tests.wording import assert_words


def described(folder: Path, **keys: object) -> Path:
    given: dict[str, object] = {
        "image": "map.pgm",
        "resolution": 0.05,
        "origin": [1.0, -2.0, 0.0],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
    }
    given.update(keys)
    file = folder / "map.yaml"
    file.write_text("".join(f"{k}: {v}\n" for k, v in given.items() if v is not None))
    return file


def painted(folder: Path, rows: list[list[int]], name: str = "map.pgm") -> None:
    Image.fromarray(np.array(rows, np.uint8)).save(folder / name)


def test_trinary_dark_is_occupied_light_free_gray_unknown_bottom_row_first(
    tmp_path: Path,
) -> None:
    painted(tmp_path, [[0, 205, 254], [254, 254, 0]])

    grid = read_map(described(tmp_path))

    assert grid.values.tolist() == [[FREE, FREE, OCCUPIED], [OCCUPIED, UNKNOWN, FREE]]
    assert grid.frame == Frame(0.05, (1.0, -2.0, 0.0))


def test_gray_of_map_saver_is_unknown_whatever_free_thresh_says(tmp_path: Path) -> None:
    painted(tmp_path, [[0, 205, 254]])
    notes: list[str] = []

    grid = read_map(described(tmp_path, free_thresh=0.25), notes.append)

    assert grid.values.tolist() == [[OCCUPIED, UNKNOWN, FREE]]
    (note,) = notes
    assert_words(note, "map.yaml", "205", "free_thresh = 0.25", "strict_thresholds: true")
    strict = described(tmp_path, free_thresh=0.25, strict_thresholds=True)
    assert read_map(strict).values.tolist() == [[OCCUPIED, FREE, FREE]]


def test_gray_in_a_drawing_is_judged_by_the_thresholds(tmp_path: Path) -> None:
    painted(tmp_path, [[0, 205, 254, 210]])
    notes: list[str] = []

    grid = read_map(described(tmp_path, free_thresh=0.25), notes.append)

    assert grid.values.tolist() == [[OCCUPIED, FREE, FREE, FREE]]
    assert notes == []


def test_negate_makes_light_occupied(tmp_path: Path) -> None:
    painted(tmp_path, [[0, 255]])

    assert read_map(described(tmp_path, negate=1)).values.tolist() == [[FREE, OCCUPIED]]


def test_origin_may_be_rotated(tmp_path: Path) -> None:
    painted(tmp_path, [[254, 254]])

    frame = read_map(described(tmp_path, origin=[1.0, 2.0, 1.5708])).frame

    assert frame.point(0, 1) == pytest.approx((0.975, 2.075), abs=1e-4)
    assert frame.cell(0.975, 2.075) == (0, 1)


def test_scale_gives_probabilities_and_transparent_pixels_are_unknown(tmp_path: Path) -> None:
    light = np.array([[255, 128, 0, 128]], np.uint8)
    opaque = np.array([[255, 255, 255, 0]], np.uint8)
    Image.fromarray(np.dstack((light, opaque))).save(tmp_path / "map.png")

    file = described(tmp_path, image="map.png", mode="scale", free_thresh=0.1, occupied_thresh=0.9)
    free, half, occupied, transparent = read_map(file).values[0].tolist()

    assert (free, occupied, transparent) == (FREE, OCCUPIED, UNKNOWN)
    assert half == pytest.approx(50, abs=1)


def test_raw_mode_takes_pixels_as_cell_values(tmp_path: Path) -> None:
    painted(tmp_path, [[0, 42, 100, 255]])

    file = described(tmp_path, mode="raw")

    assert read_map(file).values.tolist() == [[0, 42, 100, UNKNOWN]]


@settings(max_examples=30, deadline=None)
@given(
    mode=st.sampled_from(["trinary", "scale", "raw"]),
    rows=st.integers(1, 6),
    columns=st.integers(1, 6),
    seed=st.integers(0, 1000),
)
def test_written_map_is_read_back_unchanged(
    tmp_path_factory: pytest.TempPathFactory, mode: Mode, rows: int, columns: int, seed: int
) -> None:
    random = np.random.default_rng(seed)
    choices = [FREE, OCCUPIED, UNKNOWN] if mode == "trinary" else list(range(-1, 101))
    values = random.choice(np.array(choices, np.int8), (rows, columns))
    grid = Grid(values, Frame(0.1, (-3.0, 4.5, 0.3)))
    file = tmp_path_factory.mktemp("map") / "written.yaml"

    write_map(file, grid, mode)

    again = read_map(file)
    assert np.array_equal(again.values, values)
    assert again.frame == grid.frame


@pytest.mark.parametrize(
    ("keys", "named"),
    [
        ({"resolution": -0.05}, "resolution"),
        ({"resolution": None}, "resolution"),
        ({"origin": [0.0, ".nan", 0.0]}, "origin"),
        ({"free_thresh": 0.7}, "free_thresh = 0.7 is not below"),
        ({"mode": "fancy"}, "mode"),
        ({"image": "other.pgm"}, "other.pgm: no such image"),
        ({"width": 7, "height": 1}, "width = 7, but"),
    ],
)
def test_invalid_file_is_rejected_with_its_name_and_the_value(
    tmp_path: Path, keys: dict[str, object], named: str
) -> None:
    painted(tmp_path, [[0, 255]])

    with pytest.raises(CairnError) as error:
        read_map(described(tmp_path, **keys))

    assert named in str(error.value)
    assert "map.yaml" in str(error.value) or "other.pgm" in str(error.value)


def test_full_disk_is_reported_and_leaves_the_old_map_unchanged(tmp_path: Path) -> None:
    file = tmp_path / "map.yaml"
    old = Grid(np.full((40, 40), OCCUPIED, np.int8), Frame(0.05))
    write_map(file, old)

    with (
        room_for(1000),
        pytest.raises(CairnError, match=r"map\.yaml: .*File too large; .*ulimit.*another folder"),
    ):
        write_map(file, Grid(np.zeros((40, 40), np.int8), Frame(0.05)))

    assert np.array_equal(read_map(file).values, old.values)
    assert sorted(one.name for one in tmp_path.iterdir()) == ["map.pgm", "map.yaml"]


def test_damaged_image_and_missing_map_are_rejected(tmp_path: Path) -> None:
    (tmp_path / "map.pgm").write_bytes(b"P5\n100 100\n255\nshort")

    with pytest.raises(CairnError, match=r"map\.pgm: is truncated or damaged \(.* 5 of 10000"):
        read_map(described(tmp_path))
    with pytest.raises(CairnError, match="no such file"):
        read_map(tmp_path / "none.yaml")

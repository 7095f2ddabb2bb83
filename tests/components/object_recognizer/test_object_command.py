"""Tests of `cairn object`."""

import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from cairn.components.object_recognizer import object_cli
from cairn.testing.launching import launching
from cairn.visual_map.object_models import read_models
from cairn.visual_map.sqlite_file import connect, create
from tests.commands import Answer, cairn
from tests.components.object_recognizer.scenes import picture_of
from tests.patience import LIMIT_S
from tests.wording import assert_words

pytestmark = [pytest.mark.processes, pytest.mark.images]


ROOT = Path(__file__).parents[3]


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Run the commands in an empty folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("CAIRN_VISUAL_MAP", raising=False)
    return tmp_path


def photo(name: str, picture: np.ndarray[Any, Any]) -> str:
    assert cv2.imwrite(name, picture)
    return name


@pytest.fixture(scope="module")
def map_with_a_cup(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a map with a model of a cup, `picture_of(1)`, without its size; tests must copy it."""
    folder = tmp_path_factory.mktemp("taught")
    image = photo(str(folder / "a.png"), picture_of(1))
    taught = cairn("object", "teach", "cup", image, "--map", str(folder / "cup.cairn"))
    assert taught.code == 0, taught
    return folder / "cup.cairn"


@pytest.fixture
def cup(folder: Path, map_with_a_cup: Path) -> None:
    """Copy the map with the cup to the folder."""
    shutil.copy(map_with_a_cup, folder / "visual_map.cairn")


@pytest.fixture
def skip_visibility_test(monkeypatch: pytest.MonkeyPatch) -> None:
    """Skip the search for the smallest recognized size, which dominates the time of teaching."""
    monkeypatch.setattr(object_cli, "smallest_recognized_size", lambda _: 45)


def rejected(*arguments: str) -> str:
    answer = cairn(*arguments)
    assert answer.code == 1
    assert answer.out == ""
    return answer.err


def test_object_is_taught_listed_shown_and_removed(folder: Path) -> None:
    taught = cairn("object", "teach", "cup", photo("cup.png", picture_of(1)), "--size", "0.4,0.3")
    assert (taught.code, "cup (object 1) has 1 view in visual_map.cairn" in taught.out) == (0, True)
    assert "visual_map.cairn is new" in taught.err

    again = cairn("object", "teach", "cup", photo("b.png", picture_of(2)), "--json").json
    assert (again["object_id"], again["views"], again["map"]) == (1, 2, "visual_map.cairn")
    (view,) = again["taught"]
    assert 45 <= view.pop("recognized_from") <= 90
    assert view == {"image": "b.png", "width": 400, "height": 300, "features": 300}
    assert (again["look_alikes"], again["remarks"]) == ([], [])

    (row,) = cairn("object", "list", "--json").json
    assert row == {
        "object_id": 1, "name": "cup", "width_m": 0.4, "height_m": 0.3, "views": 2,
        "features": 600,
    }  # fmt: skip
    assert cairn("object", "list").out.splitlines()[1].split() == (
        ["1", "cup", "0.40", "0.30", "2", "600"]
    )

    shown = cairn("object", "show", "cup", "--out", "cup_views.png", "--json").json
    assert [view["features"] for view in shown["views"]] == [300, 300]
    assert np.std(np.asarray(cv2.imread("cup_views.png"))) > 10

    assert "no longer recognized" in cairn("object", "remove", "cup").out
    assert_words(cairn("object", "list").out.strip(), "no object models")


@pytest.mark.usefixtures("skip_visibility_test")
def test_landmark_keeps_its_identifier(folder: Path) -> None:
    create(folder / "m.cairn", "a test").close()
    with connect(folder / "m.cairn") as connection:
        connection.execute(
            "INSERT INTO objects (object_id, name, reliability, state, evidence_count) "
            "VALUES (7, 'poster', 0.5, 0, 0)"
        )
    connection.close()
    picture = photo("a.png", picture_of(1))

    poster = cairn("object", "teach", "poster", picture, "--map", "m.cairn", "--json").json
    cup = cairn("object", "teach", "cup", picture, "--map", "m.cairn", "--json").json

    assert (poster["object_id"], cup["object_id"]) == (7, 8)


@pytest.mark.usefixtures("skip_visibility_test")
def test_box_selects_a_part_of_the_photograph(folder: Path) -> None:
    scene = np.full((600, 800), 90, np.uint8)
    scene[100:400, 300:700] = picture_of(1)
    photo("scene.png", scene)

    cairn("object", "teach", "cup", "scene.png", "--box", "300,100,400,300")

    (cup,) = read_models(Path("visual_map.cairn")).models
    np.testing.assert_array_equal(cup.views[0].picture, picture_of(1))
    assert "exceeds the image of 800 x 600" in rejected(
        "object", "teach", "mug", "scene.png", "--box", "500,100,400,300"
    )


@pytest.mark.accuracy
@pytest.mark.usefixtures("cup", "skip_visibility_test")
def test_similar_objects_are_reported(folder: Path) -> None:
    cairn("object", "teach", "book", photo("b.png", picture_of(2)))

    answer = cairn("object", "teach", "mug", photo("c.png", picture_of(1)), "--json").json

    assert answer["look_alikes"] == ["cup"]
    assert "mug looks like cup" in answer["remarks"][0]


@pytest.mark.usefixtures("skip_visibility_test")
def test_picture_of_tiles_is_taught_with_a_remark(folder: Path) -> None:
    tiles = photo("a.png", np.tile(picture_of(1)[:150, :150], (2, 3)))

    answer = cairn("object", "teach", "carpet", tiles, "--size", "0.6,0.4", "--json").json

    assert answer["views"] == 1
    assert "a.png repeats the same pattern" in answer["remarks"][0]


@pytest.mark.usefixtures("skip_visibility_test")
def test_size_can_be_given_later(folder: Path) -> None:
    first = cairn("object", "teach", "cup", photo("a.png", picture_of(1)))
    assert "the size of cup is not known" in first.err

    later = cairn("object", "teach", "cup", "--size", "0.4,0.3")

    assert (later.code, later.err) == (0, "")
    assert read_models(Path("visual_map.cairn")).models[0].size == (0.4, 0.3)


@pytest.mark.usefixtures("cup", "skip_visibility_test")
def test_changed_size_is_stored_and_reported(folder: Path) -> None:
    cairn("object", "teach", "cup", "--size", "0.4,0.3")

    other = cairn("object", "teach", "cup", "--size", "0.8,0.6", "--json").json

    (remark,) = other["remarks"]
    assert_words(remark, "size", "0.4 m x 0.3 m")
    assert read_models(Path("visual_map.cairn")).models[0].size == (0.8, 0.6)


@pytest.mark.usefixtures("cup", "skip_visibility_test")
def test_photograph_is_taught_only_once(folder: Path) -> None:
    cairn("object", "teach", "cup", "--size", "0.4,0.3")
    same = photo("b.png", picture_of(1))

    again = cairn("object", "teach", "cup", same, photo("c.png", picture_of(2)), same, "--json")

    assert (again.json["views"], [one["image"] for one in again.json["taught"]]) == (2, ["c.png"])
    (remark,) = again.json["remarks"]
    assert_words(remark, "b.png", "already")


@pytest.mark.parametrize(
    ("contrast", "why"), [(0.17, "and not from farther away"), (0.1, "so little contrast")]
)
def test_low_contrast_is_reported(folder: Path, contrast: float, why: str) -> None:
    faint = photo("a.png", (120.0 + contrast * picture_of(1)).astype(np.uint8))

    taught = cairn("object", "teach", "cup", faint, "--size", "0.4,0.3", "--json").json

    (view,) = taught["taught"]
    assert view["recognized_from"] is None or view["recognized_from"] >= 160
    assert why in taught["remarks"][0]


WALL = np.full((300, 400), 180, np.uint8)
STRIPES = np.tile(np.repeat(np.array([60, 200], np.uint8), 20), (300, 10))


@pytest.mark.parametrize(
    ("picture", "why"),
    [
        (WALL, "a.png cannot be taught: it has no features"),
        (np.zeros((300, 400), np.uint8), "it has no features"),
        (cv2.circle(WALL.copy(), (200, 150), 40, 30, -1), "a.png cannot be taught"),
        (STRIPES, "a.png cannot be taught"),
        (picture_of(1)[:20, :20], "a.png cannot be taught"),
        (picture_of(1)[:4, :4], "has 4 x 4 pixels, too few"),
    ],
)
def test_unrecognizable_picture_is_rejected(
    folder: Path, picture: np.ndarray[Any, Any], why: str
) -> None:
    photo("good.png", picture_of(2))

    assert why in rejected("object", "teach", "cup", "good.png", photo("a.png", picture))

    assert not Path("visual_map.cairn").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "images; --camera"),
        (("missing.png",), "missing.png; No such file"),
        (("a.png", "--camera"), "images; --camera; not both"),
        (("a.png", "--size", "0.4"), "--size 0.4; W,H"),
        (("a.png", "--size", "0,1"), "--size 0,1; W,H"),
        (("a.png", "--size", "300,2"), "above 0; 100"),
        (("a.png", "--size", "0.3,0.4"), "1.33; 0.3 m x 0.4 m"),
        (("a.png", "--box", "1,2,3"), "--box 1,2,3; X,Y,W,H"),
        (("--size", "1,1"), "no such map file; images of cup"),
    ],
)
def test_invalid_arguments_are_rejected_with_reason(
    folder: Path, arguments: tuple[str, ...], words: str
) -> None:
    photo("a.png", picture_of(1))
    assert_words(rejected("object", "teach", "cup", *arguments), *words.split("; "))
    assert not Path("visual_map.cairn").exists()


def test_missing_maps_and_names_are_reported(folder: Path, map_with_a_cup: Path) -> None:
    photo("a.png", picture_of(1))
    assert "visual_map.cairn: no such map file" in rejected("object", "list")
    shutil.copy(map_with_a_cup, "visual_map.cairn")
    for verb in ("show", "remove"):
        assert_words(rejected("object", verb, "mug"), "'mug'", "cup")
    Path("visual_map.cairn").write_bytes(b"x" * 4000)
    for verb in ("list", "show", "remove", "teach"):
        rest = ["cup", "a.png"] if verb == "teach" else [] if verb == "list" else ["cup"]
        assert "visual_map.cairn" in rejected("object", verb, *rest)


@pytest.mark.parametrize(
    ("map_file", "words"),
    [
        ("folder", "folder; map file"),
        ("/dev/null", "/dev/null; regular file"),
        ("/proc/new.cairn", "/proc/new.cairn; No such file; path"),
        ("none/new.cairn", "--map none/new.cairn; folder none"),
        ("a.png/new.cairn", "a.png; File exists"),
        ("a.png", "a.png; not a database; damaged"),
    ],
)
def test_invalid_map_path_is_reported(folder: Path, map_file: str, words: str) -> None:
    photo("a.png", picture_of(1))
    (folder / "folder").mkdir()

    answer = rejected("object", "teach", "cup", "a.png", "--map", map_file)

    assert_words(answer, *words.split("; "))
    assert "full" not in answer


@pytest.mark.usefixtures("cup")
@pytest.mark.parametrize(
    ("picture", "words"),
    [
        ("folder", "folder; suffix; image format"),
        ("folder.png", "folder.png; Is a directory; give a file"),
        ("none/a.png", "none/a.png; cannot be written; No such file"),
        ("/proc/a.png", "/proc/a.png; cannot be written; No such file"),
    ],
)
def test_unwritable_picture_is_reported(folder: Path, picture: str, words: str) -> None:
    (folder / "folder").mkdir()
    (folder / "folder.png").mkdir()
    before = sorted(folder.rglob("*"))

    answer = rejected("object", "show", "cup", "--out", picture)

    assert_words(answer, *words.split("; "))

    assert sorted(folder.rglob("*")) == before


def test_missing_robot_is_reported(folder: Path) -> None:
    assert "127.0.0.1:9" in rejected(
        "object", "teach", "cup", "--camera", "--connect", "tcp/127.0.0.1:9"
    )


ROBOT = """
    components:
      camera: {plugin: "tests.components.object_recognizer.poster_camera:PosterCamera"}
      recognizer: {plugin: object_recognizer, parameters: {map_file: MAP}}
    """


@pytest.mark.accuracy
@pytest.mark.usefixtures("skip_visibility_test")
def test_object_in_front_of_running_robot_is_taught_and_recognized(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(object_cli, "_TIMEOUT_S", LIMIT_S)
    path = folder / "robot.cairn"
    create(path, "a test").close()
    with launching(folder) as launch:
        run = launch(ROBOT.replace("MAP", str(path)), environment={"PYTHONPATH": str(ROOT)})
        run.await_line("child active: recognizer")

        def robot(*arguments: str) -> Answer:
            return cairn(*arguments, connect=run.endpoint)

        wrong = robot("object", "teach", "poster", "--camera", "--topic", "left_info")
        assert "carries sensor_msgs/msg/CameraInfo, not images" in wrong.err

        answer = robot(
            "object", "teach", "poster", "--camera", "--box", "253,190,134,100",
            "--size", "0.402,0.3", "--json",
        ).json  # fmt: skip
        assert (answer["object_id"], answer["map"]) == (1, str(path))
        assert answer["taught"][0]["image"] == "/robot/left_image"

        run.await_line("loaded 1 object models from")
        seen = robot("topic", "echo", "objects", "--count", "4", "--json").out.splitlines()
        assert '"object_id": 1' in seen[-1]
        assert run.stop() == 0

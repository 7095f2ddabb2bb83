"""`cairn object`: what it teaches, shows and refuses."""

import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from cairn.testing.launching import launching
from cairn.visual_map.file import connect, create
from cairn.visual_map.object_models import read_models
from tests.commands import Answer, cairn
from tests.components.object_recognizer.scenes import picture_of

pytestmark = [pytest.mark.processes, pytest.mark.images]


ROOT = Path(__file__).parents[3]


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where the commands are given."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("CAIRN_VISUAL_MAP", raising=False)
    return tmp_path


def photo(name: str, picture: np.ndarray[Any, Any]) -> str:
    assert cv2.imwrite(name, picture)
    return name


@pytest.fixture(scope="module")
def map_with_a_cup(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A map to which the cup of `picture_of(1)` is taught, without its size; not to be changed."""
    folder = tmp_path_factory.mktemp("taught")
    image = photo(str(folder / "a.png"), picture_of(1))
    taught = cairn("object", "teach", "cup", image, "--map", str(folder / "cup.cairn"))
    assert taught.code == 0, taught
    return folder / "cup.cairn"


@pytest.fixture
def cup(folder: Path, map_with_a_cup: Path) -> None:
    """The cup is taught here already."""
    shutil.copy(map_with_a_cup, folder / "visual_map.cairn")


def refused(*arguments: str) -> str:
    answer = cairn(*arguments)
    assert answer.code == 1
    assert answer.out == ""
    return answer.err


def test_an_object_is_taught_listed_shown_and_removed(folder: Path) -> None:
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
    assert cairn("object", "list").out.strip() == "no object was taught"


def test_an_object_of_the_map_keeps_its_number(folder: Path) -> None:
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


def test_a_part_of_a_photograph_is_taught_by_a_box(folder: Path) -> None:
    scene = np.full((600, 800), 90, np.uint8)
    scene[100:400, 300:700] = picture_of(1)
    photo("scene.png", scene)

    cairn("object", "teach", "cup", "scene.png", "--box", "300,100,400,300")

    (cup,) = read_models(Path("visual_map.cairn")).objects
    np.testing.assert_array_equal(cup.views[0].picture, picture_of(1))
    assert "reaches beyond the image of 800 x 600" in refused(
        "object", "teach", "mug", "scene.png", "--box", "500,100,400,300"
    )


@pytest.mark.usefixtures("cup")
def test_what_looks_alike_is_told(folder: Path) -> None:
    cairn("object", "teach", "book", photo("b.png", picture_of(2)))

    told = cairn("object", "teach", "mug", photo("c.png", picture_of(1)), "--json").json

    assert told["look_alikes"] == ["cup"]
    assert "mug looks like cup" in told["remarks"][0]


def test_a_picture_of_tiles_is_taught_with_a_warning(folder: Path) -> None:
    tiles = photo("a.png", np.tile(picture_of(1)[:150, :150], (2, 3)))

    told = cairn("object", "teach", "carpet", tiles, "--size", "0.6,0.4", "--json").json

    assert told["views"] == 1
    assert "a.png shows the same thing at several places" in told["remarks"][0]


def test_a_size_can_be_told_later(folder: Path) -> None:
    first = cairn("object", "teach", "cup", photo("a.png", picture_of(1)))
    assert "the size of cup is not known" in first.err

    later = cairn("object", "teach", "cup", "--size", "0.4,0.3")

    assert (later.code, later.err) == (0, "")
    assert read_models(Path("visual_map.cairn")).objects[0].size == (0.4, 0.3)


@pytest.mark.usefixtures("cup")
def test_another_size_is_taken_and_told(folder: Path) -> None:
    cairn("object", "teach", "cup", "--size", "0.4,0.3")

    other = cairn("object", "teach", "cup", "--size", "0.8,0.6", "--json").json

    assert other["remarks"] == ["its size was 0.4 m x 0.3 m until now"]
    assert read_models(Path("visual_map.cairn")).objects[0].size == (0.8, 0.6)


@pytest.mark.usefixtures("cup")
def test_a_photograph_is_taught_once(folder: Path) -> None:
    cairn("object", "teach", "cup", "--size", "0.4,0.3")
    same = photo("b.png", picture_of(1))

    again = cairn("object", "teach", "cup", same, photo("c.png", picture_of(2)), same, "--json")

    assert (again.json["views"], [one["image"] for one in again.json["taught"]]) == (2, ["c.png"])
    assert again.json["remarks"] == ["b.png is a view of it already: left out"]


@pytest.mark.parametrize(
    ("contrast", "why"), [(0.17, "and not from farther away"), (0.1, "so little contrast")]
)
def test_what_is_hardly_seen_by_a_camera_is_told(folder: Path, contrast: float, why: str) -> None:
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
        (WALL, "a.png cannot be taught: it shows nothing that stands out"),
        (np.zeros((300, 400), np.uint8), "nothing that stands out"),
        (cv2.circle(WALL.copy(), (200, 150), 40, 30, -1), "a.png cannot be taught"),
        (STRIPES, "a.png cannot be taught"),
        (picture_of(1)[:20, :20], "a.png cannot be taught"),
        (picture_of(1)[:4, :4], "has 4 x 4 pixels: too few"),
    ],
)
def test_what_would_not_be_recognized_is_not_taught(
    folder: Path, picture: np.ndarray[Any, Any], why: str
) -> None:
    photo("good.png", picture_of(2))

    assert why in refused("object", "teach", "cup", "good.png", photo("a.png", picture))

    assert not Path("visual_map.cairn").exists()


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        ((), "give images of the object, or --camera"),
        (("missing.png",), "missing.png cannot be read: No such file"),
        (("a.png", "--camera"), "give images or --camera, not both"),
        (("a.png", "--size", "0.4"), "--size 0.4: write it as W,H"),
        (("a.png", "--size", "0,1"), "--size 0,1: write it as W,H"),
        (("a.png", "--size", "300,2"), "in meters, above 0 and at most 100"),
        (("a.png", "--size", "0.3,0.4"), "1.33 times as wide as high, but the size 0.3 m x 0.4 m"),
        (("a.png", "--box", "1,2,3"), "--box 1,2,3: write it as X,Y,W,H"),
        (("--size", "1,1"), "no such map file: give images of cup"),
    ],
)
def test_what_cannot_be_taught_is_refused_in_words(
    folder: Path, arguments: tuple[str, ...], why: str
) -> None:
    photo("a.png", picture_of(1))
    assert why in refused("object", "teach", "cup", *arguments)
    assert not Path("visual_map.cairn").exists()


def test_maps_and_names_that_are_not_there_are_told(folder: Path, map_with_a_cup: Path) -> None:
    photo("a.png", picture_of(1))
    assert "visual_map.cairn: no such map file" in refused("object", "list")
    shutil.copy(map_with_a_cup, "visual_map.cairn")
    for verb in ("show", "remove"):
        assert "no object 'mug' was taught; taught are: cup" in refused("object", verb, "mug")
    Path("visual_map.cairn").write_bytes(b"x" * 4000)
    for verb in ("list", "show", "remove", "teach"):
        rest = ["cup", "a.png"] if verb == "teach" else [] if verb == "list" else ["cup"]
        assert "visual_map.cairn" in refused("object", verb, *rest)


@pytest.mark.parametrize(
    ("map_file", "why"),
    [
        ("folder", "folder is a folder. Give a map file"),
        ("/dev/null", "/dev/null is no file that can hold a map"),
        ("/proc/new.cairn", "/proc/new.cairn: No such file or directory; correct the path"),
        ("none/new.cairn", "--map none/new.cairn: there is no folder none: make it, or correct it"),
        ("a.png/new.cairn", "a.png: File exists; something else has this name"),
        ("a.png", "a.png: file is not a database. It is damaged or no map"),
    ],
)
def test_what_cannot_hold_a_map_is_told_as_it_is(folder: Path, map_file: str, why: str) -> None:
    photo("a.png", picture_of(1))
    (folder / "folder").mkdir()

    told = refused("object", "teach", "cup", "a.png", "--map", map_file)

    assert why in told
    assert "full" not in told


@pytest.mark.usefixtures("cup")
@pytest.mark.parametrize(
    ("picture", "why"),
    [
        ("folder", "folder: its name does not tell what kind of picture it is to be"),
        ("folder.png", "folder.png cannot be written: Is a directory; it is a folder: name a file"),
        ("none/a.png", "none/a.png cannot be written: No such file or directory"),
        ("/proc/a.png", "/proc/a.png cannot be written: No such file or directory"),
    ],
)
def test_a_picture_that_cannot_be_written_is_told(folder: Path, picture: str, why: str) -> None:
    (folder / "folder").mkdir()
    (folder / "folder.png").mkdir()
    before = sorted(folder.rglob("*"))

    assert why in refused("object", "show", "cup", "--out", picture)

    assert sorted(folder.rglob("*")) == before


def test_without_a_robot_the_camera_is_told_to_be_missing(folder: Path) -> None:
    assert "127.0.0.1:9" in refused(
        "object", "teach", "cup", "--camera", "--connect", "tcp/127.0.0.1:9"
    )


ROBOT = """
    components:
      camera: {plugin: "tests.components.object_recognizer.playing:PosterCamera"}
      recognizer: {plugin: object_recognizer, parameters: {map_file: MAP}}
    """


def test_an_object_before_a_running_robot_is_taught_and_recognized(folder: Path) -> None:
    path = folder / "robot.cairn"
    create(path, "a test").close()
    with launching(folder) as launch:
        run = launch(ROBOT.replace("MAP", str(path)), environment={"PYTHONPATH": str(ROOT)})
        run.await_line("recognizer active")

        def robot(*arguments: str) -> Answer:
            return cairn(*arguments, connect=run.endpoint)

        wrong = robot("object", "teach", "poster", "--camera", "--topic", "left_info")
        assert "carries sensor_msgs/msg/CameraInfo, not images" in wrong.err

        told = robot(
            "object", "teach", "poster", "--camera", "--box", "253,190,134,100",
            "--size", "0.402,0.3", "--json",
        ).json  # fmt: skip
        assert (told["object_id"], told["map"]) == (1, str(path))
        assert told["taught"][0]["image"] == "/robot/left_image"

        run.await_line("1 taught objects of .* are recognized")
        seen = robot("topic", "echo", "objects", "--count", "4", "--json").out.splitlines()
        assert '"object_id": 1' in seen[-1]
        assert run.stop() == 0

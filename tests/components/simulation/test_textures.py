"""Pictures on objects: drawn ones differ, files are read or rejected, surveys teach them."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from cairn import CairnError
from cairn.components.simulation.camera import seen_from
from cairn.components.simulation.survey import surveyed_models
from cairn.components.simulation.textures import (
    LONGEST_PX,
    drawn_picture,
    read_picture,
    surface_pattern,
)
from cairn.components.simulation.world_checks import world_problems
from cairn.components.simulation.world_file import read_world
from cairn.vision.features import extract
from cairn.vision.object_model import ObjectModel
from cairn.vision.recognition import Recognizer
from cairn.vision.teaching import make_view
from tests.commands import cairn
from tests.components.simulation.worlds import RADIUS, box

pytestmark = pytest.mark.images


ROOM = Path(__file__).parents[3] / "deploy" / "worlds" / "room.yaml"


@pytest.mark.accuracy
def test_drawn_pictures_are_rich_in_features_and_distinct() -> None:
    pictures = [drawn_picture(number, (0.5, 0.4)) for number in range(1, 9)]
    known = [
        ObjectModel(number, "", None, (make_view(one),)) for number, one in enumerate(pictures)
    ]
    recognizer = Recognizer(known)

    assert np.array_equal(pictures[0], drawn_picture(1, (0.5, 0.4)))
    assert {one.shape for one in pictures} == {(320, 400)}
    for number, picture in enumerate(pictures):
        features = extract(np.asarray(cv2.GaussianBlur(picture, (0, 0), 1.0), np.uint8))
        assert len(features) > 300
        found = recognizer.recognize(features, 400, 320)
        assert [one.object_id for one in found] == [number]
        assert not found[0].alternatives


def test_surface_pattern_is_weak_and_seamless() -> None:
    pattern = surface_pattern()
    gray = np.asarray(170 * np.tile(pattern, (2, 2)), np.uint8)
    picture = drawn_picture(1, (0.5, 0.5))
    inside = np.abs(np.diff(pattern, axis=1)).max()

    assert pattern.mean() == pytest.approx(1.0, abs=1e-3)
    assert np.abs(pattern[:, 0] - pattern[:, -1]).max() < 1.5 * inside
    assert gray.std() < 0.2 * picture.std()


def test_large_pictures_are_reduced_and_color_becomes_gray(tmp_path: Path) -> None:
    file = tmp_path / "large.png"
    cv2.imwrite(str(file), np.full((1000, 2000, 3), (0, 0, 255), np.uint8))

    picture = read_picture(file)

    assert picture.shape == (LONGEST_PX // 2, LONGEST_PX)
    assert 60 < picture.mean() < 90


@pytest.mark.parametrize(
    ("visible_object", "message"),
    [
        ({"texture": "none.png"}, r"object_1: .*none.png: cannot be read"),
        ({"texture": "text.png"}, r"object_1: .*text.png: not an image"),
        (
            {"z": 2.4},
            "object_1 goes from 2.25 m to 2.55 m, but the floor is at 0 m and the highest",
        ),
        ({"z": 0.1}, "object_1 goes from -0.05 m to 0.25 m"),
        ({"height": 3.0}, "object_1 goes from -0.5 m to 2.5 m"),
    ],
)
def test_objects_that_no_camera_can_show_are_rejected(
    visible_object: dict[str, object], message: str, tmp_path: Path
) -> None:
    (tmp_path / "text.png").write_text("no picture")
    file = tmp_path / "world.yaml"
    poster = {"id": 1, "x": 6, "y": 2, "theta": 3.1416, **visible_object}
    for world in (
        box(objects=[poster]),
        box(events=[{"at": 1.0, "add_object": poster}]),
    ):
        file.write_text(yaml.safe_dump(world))
        answer = cairn("world", "check", str(file))

        assert answer.code == 1
        (problem,) = world_problems(read_world(file), RADIUS)
        with pytest.raises(CairnError, match=message):
            raise CairnError(problem)
        assert problem in answer.err


def test_texture_paths_are_relative_to_the_world_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "pictures").mkdir()
    picture = drawn_picture(77, (0.5, 0.4))
    cv2.imwrite(str(tmp_path / "pictures" / "one.png"), picture)
    file = tmp_path / "world.yaml"
    poster = {"id": 1, "x": 6, "y": 2, "theta": 3.1416, "texture": "pictures/one.png"}
    file.write_text(yaml.safe_dump(box(objects=[{**poster, "width": 0.5, "height": 0.4}])))
    monkeypatch.chdir("/")

    (taught,) = surveyed_models(file)

    assert (taught.object_id, taught.name, taught.size) == (1, "object_1", (0.5, 0.4))
    assert np.array_equal(taught.views[0].picture, picture)


@pytest.mark.accuracy
def test_objects_of_the_room_are_recognized_at_their_poses() -> None:
    world = read_world(ROOM)
    recognizer = Recognizer(surveyed_models(ROOM))
    for pose, there in (
        ((1.8, 2.4, 3.1), {1}),
        ((4.7, 5.2, 1.57), {3, 4}),
        ((2.6, 2.0, -1.57), {9, 10}),
    ):
        image = seen_from(world, pose, 1.0, right=False)
        found = recognizer.recognize(extract(image), image.shape[1], image.shape[0])
        assert {one.object_id for one in found} == there


def test_see_writes_the_image_of_either_camera(tmp_path: Path) -> None:
    images = []
    for more in ([], ["--right"]):
        out = tmp_path / "seen.png"
        answer = cairn("world", "see", str(ROOM), "1.8", "2.4", "180deg", str(out), *more)
        assert answer.out == f"{out} was written\n"
        images.append(np.asarray(cv2.imread(str(out), cv2.IMREAD_UNCHANGED)))

    assert images[0].shape == (480, 640)
    assert np.any(images[0] != images[1])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["0", "2", "0", "seen.png"], "the camera cannot be at (0.00, 2.00): wall 1 is 0.00 m"),
        (["-2", "2", "0", "seen.png"], "outside the walls"),
        (["4", "1", "0", "seen.png", "--height", "3"], "not below the ceiling"),
        (["4", "1", "0", "seen.txt"], "use .png or .jpg"),
        (["4", "1", "0", "no/such/seen.png"], "cannot be written"),
        (["4", "1", "north", "seen.png"], "'north' is not a number"),
    ],
)
def test_see_rejects_impossible_requests(
    arguments: list[str], message: str, tmp_path: Path
) -> None:
    *place, name = arguments[:4]
    answer = cairn("world", "see", str(ROOM), *place, str(tmp_path / name), *arguments[4:])

    assert answer.code == 1
    assert message in answer.err
    assert answer.err.count("\n") == 1

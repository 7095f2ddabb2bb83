"""`cairn view` draws map, scan and robot at their places, in any size."""

import math

import numpy as np
import pytest

from cairn.planar.messages import pose_message
from cairn.schemas.cairn_nav_msgs import LocalizationEstimate, NavigationStatus, Zone, Zones
from cairn.schemas.geometry_msgs import PoseStamped, PoseWithCovariance
from cairn.schemas.map_msgs import OccupancyGridUpdate
from cairn.schemas.nav_msgs import MapMetaData, OccupancyGrid, Path
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import Header
from cairn.tools.terminal_map import Camera, Scene, draw

ROOM = np.zeros((40, 80), np.int8)  # 8 m by 4 m, with walls around
ROOM[[0, -1], :] = ROOM[:, [0, -1]] = 100


@pytest.fixture
def scene() -> Scene:
    """A robot at (2, 1) that faces the wall at x = 8, with a path to (6, 3)."""
    scene = Scene()
    info = MapMetaData(resolution=0.1, width=80, height=40)
    scene.take("map", OccupancyGrid(info=info, data=ROOM.ravel()))
    pose = PoseWithCovariance(pose=pose_message((2.0, 1.0, 0.0)))
    scene.take("localization", LocalizationEstimate(located=True, pose=pose, health=1.0))
    ranges = np.array([6.0, math.inf], np.float32)
    scene.take("scan", LaserScan(header=Header(), range_max=10.0, ranges=ranges))
    ends = (pose_message((2.0, 1.0, 0.0)), pose_message((6.0, 3.0, 0.0)))
    scene.take("path", Path(poses=tuple(PoseStamped(pose=end) for end in ends)))
    scene.refresh()
    return scene


@pytest.mark.parametrize("size", [(80, 22), (200, 50), (20, 6)])
def test_everything_is_in_the_picture_at_its_place(scene: Scene, size: tuple[int, int]) -> None:
    canvas = draw(scene, Camera(), size)
    rows = canvas.text().split("\n")

    assert (len(rows), {len(row) for row in rows}) == (size[1], {size[0]})
    [robot] = [(row, text.index("→")) for row, text in enumerate(rows) if "→" in text]
    [goal] = [(row, text.index("G")) for row, text in enumerate(rows) if "G" in text]
    assert goal[0] < robot[0], "the y axis is up"
    assert goal[1] > robot[1], "the x axis is to the right"
    scan = [style for parts in canvas.runs() for _, style in parts]
    assert "red" in scan
    assert scene.scan_points().tolist() == [[8.0, 1.0]]


def test_update_of_the_map_and_the_end_of_the_mission_are_shown(scene: Scene) -> None:
    before = len(scene.walls)
    update = OccupancyGridUpdate(x=10, y=10, width=2, height=1, data=np.full(2, 100, np.int8))
    scene.take("map_updates", update)
    outside = OccupancyGridUpdate(x=79, y=0, width=2, height=1, data=np.full(2, 100, np.int8))
    scene.take("map_updates", outside)
    scene.take("navigation_status", NavigationStatus(state=NavigationStatus.SUCCEEDED))
    scene.refresh()

    assert len(scene.walls) == before + 2
    assert scene.goal is None
    assert "succeeded" in scene.summary()


def test_zones_are_drawn_with_their_colors_and_places(scene: Scene) -> None:
    before = {style for parts in draw(scene, Camera(), (80, 22)).runs() for _, style in parts}
    corners = np.array([3.0, 0.5, 4.0, 0.5, 4.0, 1.5, 3.0, 1.5])
    four, one = np.array([4], np.uint32), np.array([1], np.uint32)
    stairs = Zone(kind=Zone.KEEPOUT, name="stairs", rings=four, points=corners)
    ramp = Zone(kind=Zone.SLOW, name="ramp", speed=0.2, rings=four, points=corners + 2.0)
    dock = Zone(kind=Zone.PLACE, name="dock", rings=one, points=np.array([1.0, 3.0]))
    scene.take("zones", Zones(zones=(stairs, ramp, dock)))

    canvas = draw(scene, Camera(), (80, 22))

    styles = {style for parts in canvas.runs() for _, style in parts}
    assert styles - before == {"magenta", "yellow", "bold cyan"}
    [(row, column)] = [
        (row, text.index("o")) for row, text in enumerate(canvas.text().split("\n")) if "o" in text
    ]
    assert row < 11
    assert column < 20


def test_keys_zoom_and_move_the_picture(scene: Scene) -> None:
    camera, dots = Camera(), (160, 88)
    camera.aim(scene, dots)
    whole = camera.meters
    for key in ("+", "right", "nonsense"):
        camera.press(key, dots)
    camera.aim(scene, dots)
    assert camera.meters < whole
    assert camera.center[0] > 4.0
    camera.press("f", dots)
    camera.aim(scene, dots)
    assert camera.center == (2.0, 1.0)
    camera.press("a", dots)
    camera.aim(scene, dots)
    assert camera.meters == whole


def test_without_a_map_the_scan_is_drawn_around_the_robot() -> None:
    scene = Scene()
    ranges = np.full(8, 2.0, np.float32)
    scene.take("scan", LaserScan(header=Header(), range_max=10.0, ranges=ranges))
    scene.refresh()

    text = draw(scene, Camera(), (80, 22)).text()
    assert "→" in text
    assert "no localization" in scene.summary()

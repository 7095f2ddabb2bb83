"""`cairn view`: map, scan, pose, path and goal of a running robot, drawn in the terminal."""

from __future__ import annotations

import itertools
import math
import shutil
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cairn.client import NoMessageError, Robot, Subscription
from cairn.client import connect as connect_to
from cairn.errors import CairnError
from cairn.planar.grid import Grid, OccupancyCells, grid_of
from cairn.planar.messages import planar_pose
from cairn.planar.poses import Pose, compose
from cairn.planar.zones import points_of, zone_edges
from cairn.runtime.log_output import printable
from cairn.schemas.cairn_nav_msgs import (
    NAVIGATION_END_STATES,
    NAVIGATION_STATES,
    ZONE_KINDS,
    LocalizationEstimate,
    NavigationStatus,
    Zone,
    Zones,
)
from cairn.schemas.geometry_msgs import Pose as PoseMessage
from cairn.schemas.map_msgs import OccupancyGridUpdate
from cairn.schemas.message import InvalidMessage, type_name
from cairn.schemas.nav_msgs import OccupancyGrid, Path
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.tf2_msgs import TFMessage
from cairn.terminal.braille import BrailleCanvas
from cairn.terminal.options import DEFAULT_CONNECT, Connect, Domain, RobotName
from cairn.terminal.output import line, note

if TYPE_CHECKING:
    from rich.text import Text

Points = NDArray[np.float64]

_PICTURES_HZ = 4.0
_FIRST_PICTURE_S = 3.0  # how long one waits for messages if the output is not a terminal
_STALE_S = 2.0  # a scan or a pose that is older is reported
_UPDATES = 100  # windows of the map that are kept until the next picture
_OCCUPIED = 65
_REACH_M = 6.0  # around the robot, while there is no map or the view follows it
_ZOOM = 1.25
_PAN = 0.25  # of the picture's smaller side
_LEAST_METERS, _MOST_METERS = 0.002, 50.0  # of a dot
_LEAST_SIZE = (20, 6)
_ARROWS = "→↗↑↖←↙↓↘"  # by heading, from the x axis to the left
_STYLES = {
    "map": "",
    "scan": "red",
    "path": "blue",
    "keepout": "magenta",
    "slow": "yellow",
    "lane": "cyan",
    "place": "bold cyan",
    "goal": "bold magenta",
    "robot": "bold green",
}
_KEYS = "q quit  + - zoom  arrows move  f follow  a all"


class Scene:
    """The newest state of a robot, as far as it is known, in frame map."""

    def __init__(self) -> None:
        self.walls: Points = np.empty((0, 2))
        self.pose: Pose | None = None
        self.estimate: LocalizationEstimate | None = None
        self.status: NavigationStatus | None = None
        self.path: Points = np.empty((0, 2))
        self.scan: LaserScan | None = None
        self.zones: tuple[Zone, ...] = ()
        self.mounts: dict[str, Pose] = {}
        self.arrived: dict[str, float] = {}
        self._map: OccupancyCells | None = None

    def take(self, name: str, message: Any) -> None:
        """Take over a message of the source of this name."""
        self.arrived[name] = time.monotonic()
        match message:
            case OccupancyGrid():
                found = grid_of(message)
                self._map = Grid(found.values.copy(), found.frame)
            case OccupancyGridUpdate():
                self._change(message)
            case LocalizationEstimate():
                self.estimate = message
                self.pose = planar_pose(message.pose.pose) if message.located else None
            case Path():
                self.path = np.array([planar_pose(one.pose)[:2] for one in message.poses])
                self.path = self.path.reshape(-1, 2)
            case NavigationStatus():
                self.status = message
            case LaserScan():
                self.scan = message
            case Zones():
                self.zones = message.zones
            case TFMessage():
                for one in message.transforms:
                    moved, turned = one.transform.translation, one.transform.rotation
                    mount = replace(PoseMessage(), orientation=turned)
                    self.mounts[one.child_frame_id] = (moved.x, moved.y, planar_pose(mount)[2])

    def refresh(self) -> None:
        """Compute what the map shows, after all messages were taken."""
        if self._map is None or self.arrived.get("drawn map") == self._map_time:
            return
        rows, columns = np.nonzero(self._map.values >= _OCCUPIED)
        x, y, theta = self._map.frame.origin
        along = (columns + 0.5) * self._map.frame.resolution
        across = (rows + 0.5) * self._map.frame.resolution
        self.walls = np.column_stack(
            (
                x + math.cos(theta) * along - math.sin(theta) * across,
                y + math.sin(theta) * along + math.cos(theta) * across,
            )
        )
        self.arrived["drawn map"] = self._map_time

    @property
    def goal(self) -> tuple[float, float] | None:
        """The end of the path [m], unless the mission has ended."""
        ended = self.status is not None and self.status.state in NAVIGATION_END_STATES
        return None if ended or not len(self.path) else (self.path[-1, 0], self.path[-1, 1])

    def scan_points(self) -> Points:
        """Return the hits of the scan (n, 2) [m]; without a pose, around the robot."""
        if self.scan is None:
            return np.empty((0, 2))
        ranges = np.asarray(self.scan.ranges, np.float64)
        mount = self.mounts.get(self.scan.header.frame_id, (0.0, 0.0, 0.0))
        x, y, theta = compose(self.pose or (0.0, 0.0, 0.0), mount)
        angles = theta + self.scan.angle_min + self.scan.angle_increment * np.arange(ranges.size)
        hit = np.isfinite(ranges)
        ranges, angles = ranges[hit], angles[hit]
        return np.column_stack((x + ranges * np.cos(angles), y + ranges * np.sin(angles)))

    def summary(self) -> str:
        """Return in words where the robot is, what it does, and what is missing."""
        parts = []
        if self.estimate is None:
            parts.append("no localization")
        elif self.pose is None:
            parts.append(f"not located: {self.estimate.reason}")
        else:
            x, y, theta = self.pose
            parts.append(f"({x:.2f}, {y:.2f}, {math.degrees(theta):.0f} deg)")
            parts.append(f"health {self.estimate.health:.2f}")
        if self.status is not None:
            state = NAVIGATION_STATES[self.status.state]
            driving = self.status.state == NavigationStatus.DRIVING
            parts.append(f"{state}, {self.status.distance_left:.1f} m left" if driving else state)
        for name in ("scan", "localization"):
            age_s = time.monotonic() - self.arrived.get(name, -math.inf)
            if name in self.arrived and age_s > _STALE_S:
                parts.append(f"no {name} for {age_s:.0f} s")
        return printable("   ".join(parts))

    @property
    def _map_time(self) -> float:
        return max(self.arrived.get("map", 0.0), self.arrived.get("map_updates", 0.0))

    def _change(self, update: OccupancyGridUpdate) -> None:
        if self._map is None:
            return
        rows, columns = self._map.values.shape
        x, y, width, height = update.x, update.y, update.width, update.height
        if x < 0 or y < 0 or x + width > columns or y + height > rows:
            return  # of another map, which will follow
        window = update.data.reshape(height, width)
        self._map.values[y : y + height, x : x + width] = window


class Camera:
    """Which part of the plane the picture shows; north, the y axis, is up."""

    def __init__(self) -> None:
        self.center = (0.0, 0.0)
        self.meters = 0.05  # of a dot
        self.mode = "all"
        """`all` of the map, `follow` the robot, or `free`."""

    def press(self, key: str, dots: tuple[int, int]) -> None:
        """Zoom or move as a key says."""
        step = _PAN * min(dots) * self.meters
        x, y = self.center
        moves = {"left": (-step, 0.0), "right": (step, 0.0), "up": (0.0, step),
                 "down": (0.0, -step)}  # fmt: skip
        if key in moves:
            self.mode = "free"
            self.center = (x + moves[key][0], y + moves[key][1])
        elif key in ("+", "=", "-"):
            if self.mode == "all":
                self.mode = "free"
            meters = self.meters * (_ZOOM if key == "-" else 1.0 / _ZOOM)
            self.meters = min(max(meters, _LEAST_METERS), _MOST_METERS)
        elif key == "f":
            self.mode = "follow"
        elif key == "a":
            self.mode = "all"

    def aim(self, scene: Scene, dots: tuple[int, int]) -> None:
        """Move to what the mode wants to show."""
        robot = scene.pose or (0.0, 0.0, 0.0)
        if self.mode == "follow":
            self.center = robot[:2]
        elif self.mode == "all":
            if len(scene.walls):
                low, high = scene.walls.min(axis=0), scene.walls.max(axis=0)
            else:
                low, high = np.array(robot[:2]) - _REACH_M, np.array(robot[:2]) + _REACH_M
            middle, size = 0.5 * (low + high), np.maximum(high - low, 0.1)
            self.center = (float(middle[0]), float(middle[1]))
            self.meters = float(max(size / (np.array(dots) - 6.0)))

    def project(self, points: Points, dots: tuple[int, int]) -> Points:
        """Return points (n, 2) [m] in dots across and down."""
        middle = 0.5 * (np.array(dots) - 1.0)
        seen: Points = middle + (points - np.array(self.center)) / self.meters * [1.0, -1.0]
        return seen


def draw(scene: Scene, camera: Camera, size: tuple[int, int]) -> BrailleCanvas:
    """Return a picture of so many columns and lines."""
    canvas = BrailleCanvas(*size)
    dots = canvas.dots
    camera.aim(scene, dots)
    canvas.add(camera.project(scene.walls, dots), _STYLES["map"])
    for zone in scene.zones:
        style = _STYLES[ZONE_KINDS[zone.kind]]
        if zone.kind == Zone.PLACE:
            across, down = camera.project(points_of(zone), dots)[0]
            canvas.put(across, down, "o", style)
            continue
        for edge in zone_edges(zone).reshape(-1, 2, 2):
            canvas.add(camera.project(_dense(edge, camera.meters), dots), style)
    canvas.add(camera.project(_dense(scene.path, camera.meters), dots), _STYLES["path"])
    canvas.add(camera.project(scene.scan_points(), dots), _STYLES["scan"])
    if scene.goal is not None:
        across, down = camera.project(np.array([scene.goal]), dots)[0]
        canvas.put(across, down, "G", _STYLES["goal"])
    if scene.pose is not None or scene.scan is not None:
        x, y, theta = scene.pose or (0.0, 0.0, 0.0)
        across, down = camera.project(np.array([[x, y]]), dots)[0]
        arrow = _ARROWS[round(theta / (math.pi / 4)) % len(_ARROWS)]
        canvas.put(across, down, arrow, _STYLES["robot"])
    return canvas


def view(connect: Connect = DEFAULT_CONNECT, domain: Domain = 0, robot: RobotName = "") -> None:
    """Show map, scan, pose, path and goal of a running robot in the terminal; q ends it.

    + and - zoom, arrows move, f follows the robot, a shows the whole map. If the output is not a
    terminal, one picture is printed.
    """
    with connect_to(connect, domain, robot, notify=note) as client:
        sources = _subscribed(client)
        scene, camera = Scene(), Camera()
        if not sys.stdout.isatty():
            columns, lines = shutil.get_terminal_size((80, 24))
            deadline = time.monotonic() + _FIRST_PICTURE_S
            while not {"map", "scan", "localization"} <= scene.arrived.keys():
                left_s = deadline - time.monotonic()
                if left_s <= 0:
                    break
                time.sleep(min(left_s, 1.0 / _PICTURES_HZ))
                _receive(sources, scene)
            if not scene.arrived:
                raise CairnError(f"{client.name}: no map and no scan within {_FIRST_PICTURE_S:g} s")
            line(scene.summary())
            line(draw(scene, camera, (columns, max(_LEAST_SIZE[1], lines - 2))).text())
            return
        _show(client, sources, scene, camera)


def _show(
    client: Robot, sources: dict[str, Subscription[Any]], scene: Scene, camera: Camera
) -> None:
    from cairn.terminal.screen import QUIT_KEYS, screen

    name = client.name
    with suppress(KeyboardInterrupt), screen() as shown:
        while True:
            if not client.connection.is_alive():
                raise CairnError(f"{name}: the deployment has ended")
            _receive(sources, scene)
            columns, lines = (max(pair) for pair in zip(shown.size, _LEAST_SIZE, strict=True))
            canvas = draw(scene, camera, (columns, lines - 2))
            shown.draw(_picture(canvas, f"{name}   {scene.summary()}", _foot(camera)))
            due = time.monotonic() + 1.0 / _PICTURES_HZ
            key = shown.key(due - time.monotonic())
            while key:
                if key in QUIT_KEYS:
                    return
                camera.press(key, canvas.dots)
                key = shown.key(0.0)


def _foot(camera: Camera) -> str:
    return f"{_KEYS}   {camera.mode}, a character is {2 * camera.meters:.2g} m wide"


def _picture(canvas: BrailleCanvas, head: str, foot: str) -> Text:
    from rich.text import Text

    picture = Text(no_wrap=True, overflow="crop")
    picture.append(f"{head[: canvas.columns]}\n", style="bold")
    for parts in canvas.runs():
        for text, style in parts:
            picture.append(text, style=style)
        picture.append("\n")
    return picture.append(foot[: canvas.columns], style="dim")


def _subscribed(client: Robot) -> dict[str, Subscription[Any]]:
    """Subscribe to what is shown, by name; topics may appear later."""
    topics = client.topics()
    prefix = f"/{client.name}/"
    messages: dict[str, type[Any]] = {
        "map": OccupancyGrid,
        "map_updates": OccupancyGridUpdate,
        "scan": LaserScan,
        "localization": LocalizationEstimate,
        "path": Path,
        "navigation_status": NavigationStatus,
        "zones": Zones,
        "tf_static": TFMessage,
    }
    found = {}
    for name, message in messages.items():
        depth = _UPDATES if name in ("map_updates", "tf_static") else 1
        of_type = [
            one.name
            for one in topics
            if one.type_name == type_name(message) and one.name.startswith(prefix)
        ]
        usual = f"{prefix}{name}"
        # A deployment may name a topic otherwise; there is one of most types.
        topic = usual if usual in of_type or len(of_type) != 1 else of_type[0]
        found[name] = client.subscribe(topic, message, depth=depth)
    return found


def _receive(sources: dict[str, Subscription[Any]], scene: Scene) -> None:
    """Take over all messages that have arrived."""
    for name, messages in sources.items():
        for message in _arrived(messages):
            scene.take(name, message)
    scene.refresh()


def _arrived(messages: Subscription[Any]) -> Iterator[Any]:
    for _ in range(_UPDATES):
        try:
            yield messages.next(0.0)
        except NoMessageError:
            return
        except InvalidMessage:
            continue  # the components' own ports count it


def _dense(points: Points, step: float) -> Points:
    """Return points at most `step` [m] apart along a line through points (n, 2) [m]."""
    if len(points) < 2:
        return points
    parts = []
    for begin, end in itertools.pairwise(points):
        count = min(1000, max(1, math.ceil(float(np.hypot(*(end - begin))) / step)))
        parts.append(begin + np.linspace(0.0, 1.0, count, endpoint=False)[:, None] * (end - begin))
    return np.concatenate([*parts, points[-1:]])

"""Generate valid messages of any class from its definition, for property tests."""

import importlib
import inspect
import math
import pkgutil
import typing
from dataclasses import fields
from functools import cache
from typing import Any

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from cairn import schemas
from cairn.schemas.cairn_msgs import (
    LandmarkContribution,
    RecognizedObject,
    RecognizedObjectArray,
    SharedCells,
    VisualMapChange,
    VisualObject,
)
from cairn.schemas.cairn_nav_msgs import ExplorationStatus, LocalizationEstimate, Plan, Zone, Zones
from cairn.schemas.cairn_sim_msgs import WorldGeometry
from cairn.schemas.field_types import Array, Covariance2, Covariance3, Scalar, Text, finite, mark_of
from cairn.schemas.geometry_msgs import Point, Pose, PoseWithCovariance
from cairn.schemas.map_msgs import OccupancyGridUpdate
from cairn.schemas.message import type_name
from cairn.schemas.nav_msgs import MapMetaData, OccupancyGrid
from cairn.schemas.packed import Packed
from cairn.schemas.sensor_msgs import Image, LaserEcho, LaserScan, MultiEchoLaserScan

LONGEST = 6
TEXT = st.text(st.characters(exclude_characters="\0", codec="utf-8"), max_size=12)
METERS = st.floats(-1e6, 1e6)


def _every_message() -> dict[str, type[Any]]:
    found: dict[str, type[Any]] = {}
    for module_info in pkgutil.iter_modules(schemas.__path__, "cairn.schemas."):
        module = importlib.import_module(module_info.name)
        for _, cls in inspect.getmembers(module, inspect.isclass):
            if cls.__module__ == module.__name__ and "__ros_type__" in cls.__dict__:
                found[type_name(cls)] = cls
    return found


EVERY_MESSAGE = _every_message()
# The messages of ROS 2 that the reference store of definitions contains.
OF_ROS_2 = [name for name in EVERY_MESSAGE if not name.startswith(("cairn_", "map_msgs/"))]


@cache
def samples(name: str, count: int) -> list[Any]:
    """Return the same `count` messages of a type at each call."""
    found: list[Any] = []

    @settings(
        max_examples=count,
        derandomize=True,
        database=None,
        deadline=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(arbitrary(EVERY_MESSAGE[name]))
    def collect(message: Any) -> None:
        found.append(message)

    collect()
    return found


def arbitrary(cls: type[Any]) -> st.SearchStrategy[Any]:
    """Return a strategy for valid messages of a class."""
    if cls in _WITH_RULES_BETWEEN_FIELDS:
        return _WITH_RULES_BETWEEN_FIELDS[cls]()
    return _built(cls)


def _built(cls: type[Any], **known: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    hints = typing.get_type_hints(cls, include_extras=True)
    return st.builds(
        cls,
        **{field.name: known.get(field.name, _field(hints[field.name])) for field in fields(cls)},
    )


def _field(hint: Any) -> st.SearchStrategy[Any]:
    if hint == Covariance2:
        return _covariances(2)
    if hint == Covariance3:
        return _covariances(3)
    mark = mark_of(hint)
    if isinstance(mark, Scalar):
        return _scalars(mark)
    if isinstance(mark, Text):
        return st.sampled_from(mark.one_of) if mark.one_of else TEXT
    if isinstance(mark, Array):
        assert mark.check in (None, finite)
        return _arrays(mark.ros_type, mark.length, only_finite=mark.check is finite)
    if typing.get_origin(hint) is Packed:
        (element,) = typing.get_args(hint)
        return _packed(7 if element is Pose else len(fields(element)))
    if typing.get_origin(hint) is tuple:
        return st.lists(_field(typing.get_args(hint)[0]), max_size=3).map(tuple)
    return arbitrary(hint)


def _scalars(mark: Scalar) -> st.SearchStrategy[Any]:
    if mark.ros_type == "bool":
        return st.booleans()
    if not mark.ros_type.startswith("float"):
        limits = np.iinfo("uint8" if mark.ros_type == "byte" else mark.ros_type)
        highest = int(limits.max) if mark.at_most is None else int(mark.at_most)
        return st.integers(int(limits.min), highest)
    bounded = mark.finite or (mark.above, mark.at_least, mark.at_most) != (None, None, None)
    return st.floats(
        mark.above if mark.above is not None else mark.at_least,
        mark.at_most,
        exclude_min=mark.above is not None,
        allow_nan=not bounded,
        allow_infinity=not bounded,
        width=32 if mark.ros_type == "float32" else 64,
    )


def _arrays(
    ros_type: str, length: int | None = None, *, only_finite: bool = False
) -> st.SearchStrategy[Any]:
    dtype = np.dtype(ros_type)
    elements: dict[str, Any] = {}
    if dtype.kind == "f" and only_finite:
        elements = {"allow_nan": False, "allow_infinity": False}
    size: Any = st.integers(0, LONGEST) if length is None else length
    return hnp.arrays(dtype, size, elements=hnp.from_dtype(dtype, **elements))


def _packed(columns: int, rows: int | None = None) -> st.SearchStrategy[Any]:
    numbers = st.floats(allow_nan=False, allow_infinity=False)
    count = st.integers(0, 4) if rows is None else st.just(rows)
    return hnp.arrays(np.float64, st.tuples(count, st.just(columns)), elements=numbers)


def _covariances(size: int) -> st.SearchStrategy[Any]:
    roots = hnp.arrays(np.float64, (size, size), elements=st.floats(-1e3, 1e3))
    return roots.map(lambda root: (root @ root.T).ravel())


@st.composite
def _scans(draw: st.DrawFn) -> Any:
    beams = draw(st.integers(0, LONGEST))
    widest = 0.5 if beams < 16 else 4.0 / beams  # within a turn
    first, step = draw(st.floats(-3, 3)), draw(st.floats(-widest, widest))
    first, step = float(np.float32(first)), float(np.float32(step))
    last = first + max(0, beams - 1) * step
    nearest = draw(st.floats(0, 1, width=32))
    farthest = [nearest or 30.0, 30.0] if beams else [nearest, math.inf]
    intensities = draw(st.sampled_from([0, beams]))
    return draw(
        _built(
            LaserScan,
            angle_min=st.just(first),
            angle_max=st.sampled_from([last, last + step]),
            angle_increment=st.just(step),
            time_increment=st.floats(-0.5, 0.5, width=32).map(lambda t: t / max(1, beams)),
            range_min=st.just(nearest),
            range_max=st.sampled_from(farthest),
            ranges=_arrays("float32", beams),
            intensities=_arrays("float32", intensities),
        )
    )


@st.composite
def _multi_echo_scans(draw: st.DrawFn) -> Any:
    sizes = draw(st.lists(st.integers(0, 3), max_size=4))

    def echoes() -> Any:
        return st.tuples(*(_built(LaserEcho, echoes=_arrays("float32", size)) for size in sizes))

    intensities = st.one_of(st.just(()), echoes())
    return draw(_built(MultiEchoLaserScan, ranges=echoes(), intensities=intensities))


@st.composite
def _images(draw: st.DrawFn) -> Any:
    height, step = draw(st.integers(0, 4)), draw(st.integers(0, 9))
    return draw(
        _built(
            Image,
            height=st.just(height),
            step=st.just(step),
            data=_arrays("uint8", height * step),
        )
    )


@st.composite
def _grids(draw: st.DrawFn) -> Any:
    width, height = draw(st.integers(0, 4)), draw(st.integers(0, 5))
    info = _built(
        MapMetaData,
        width=st.just(width),
        height=st.just(height),
        resolution=st.floats(2**-9, 10, width=32),
        origin=_built(Pose, position=_built(Point, x=METERS, y=METERS)),
    )
    cells = hnp.arrays(np.int8, width * height, elements=st.integers(-1, 100))
    return draw(_built(OccupancyGrid, info=info, data=cells))


@st.composite
def _grid_updates(draw: st.DrawFn) -> Any:
    width, height = draw(st.integers(0, 4)), draw(st.integers(0, 5))
    cells = hnp.arrays(np.int8, width * height, elements=st.integers(-1, 100))
    return draw(
        _built(OccupancyGridUpdate, width=st.just(width), height=st.just(height), data=cells)
    )


def _plans() -> st.SearchStrategy[Plan]:
    none = st.just(math.nan)
    return st.one_of(
        _built(Plan, nearest_x=METERS, nearest_y=METERS),
        _built(Plan, nearest_x=none, nearest_y=none),
    )


def _estimates() -> st.SearchStrategy[LocalizationEstimate]:
    position = _built(Point, x=METERS, y=METERS)
    pose = _built(PoseWithCovariance, pose=_built(Pose, position=position))
    return _built(LocalizationEstimate, pose=pose)


def _explorations() -> st.SearchStrategy[ExplorationStatus]:
    none = st.just(math.nan)
    return st.one_of(
        _built(ExplorationStatus, goal_x=METERS, goal_y=METERS),
        _built(ExplorationStatus, goal_x=none, goal_y=none),
    )


@st.composite
def _scenes(draw: st.DrawFn) -> Any:
    segments, objects = draw(st.integers(0, 3)), draw(st.integers(0, 3))
    return draw(
        _built(
            WorldGeometry,
            segments=_arrays("float64", 4 * segments),
            surfaces=_arrays("uint8", segments),
            heights=_arrays("float64", segments),
            solids=_arrays("uint32", segments),
            object_ids=_arrays("uint32", objects),
            object_names=st.lists(TEXT, min_size=objects, max_size=objects).map(tuple),
            object_poses=_packed(7, objects),
            object_sizes=_arrays("float64", 2 * objects),
            object_zs=_arrays("float64", objects),
            object_textures=st.lists(TEXT, min_size=objects, max_size=objects).map(tuple),
        )
    )


def _recognized() -> st.SearchStrategy[RecognizedObject]:
    corners = st.sampled_from([0, 8]).flatmap(
        lambda count: _arrays("float64", count, only_finite=True)
    )
    return _built(RecognizedObject, corners=corners)


@st.composite
def _recognized_arrays(draw: st.DrawFn) -> Any:
    right, left = sorted(draw(st.tuples(METERS, METERS)))
    nearest, farthest = sorted(draw(st.tuples(st.floats(0, 1e6), st.floats(0, 1e6))))
    return draw(
        _built(
            RecognizedObjectArray,
            view_right=st.just(right),
            view_left=st.just(left),
            nearest=st.just(nearest),
            farthest=st.just(farthest),
        )
    )


def _visual_objects() -> st.SearchStrategy[VisualObject]:
    return st.one_of(
        _built(VisualObject, candidate_x=METERS, candidate_y=METERS),
        _built(VisualObject, candidate_x=st.just(math.nan), candidate_y=st.just(math.nan)),
    )


def _contributions() -> st.SearchStrategy[LandmarkContribution]:
    nowhere = st.just(math.nan)
    return st.one_of(
        _built(LandmarkContribution, x=METERS, y=METERS),
        _built(LandmarkContribution, x=nowhere, y=nowhere),
    )


def _changes() -> st.SearchStrategy[VisualMapChange]:
    none = st.just(math.nan)
    return st.one_of(
        _built(VisualMapChange, old_x=none, old_y=none, new_x=METERS, new_y=METERS),
        _built(VisualMapChange, old_x=METERS, old_y=METERS, new_x=none, new_y=none),
    )


def _shared_cells() -> st.SearchStrategy[SharedCells]:
    none = st.just(math.nan)
    return st.one_of(_built(SharedCells, x=METERS, y=METERS), _built(SharedCells, x=none, y=none))


@st.composite
def zones(draw: st.DrawFn) -> Zone:
    """Draw a zone of any kind; the edges of an area may cross."""
    kind = draw(st.integers(0, 3))
    least = (3, 3, 2, 1)[kind]
    sizes = [draw(st.integers(least, 6 if kind != Zone.PLACE else 1))]
    if kind in (Zone.KEEPOUT, Zone.SLOW):
        sizes += draw(st.lists(st.integers(3, 5), max_size=2))
    flat = hnp.arrays(np.float64, 2 * sum(sizes), elements=st.floats(-1e5, 1e5))
    headings = st.one_of(st.just(math.nan), st.floats(-6, 6))
    return Zone(
        kind=kind,
        name=draw(st.from_regex(r"z[a-z0-9 ]{0,5}[a-z]", fullmatch=True)),
        speed=draw(st.floats(0.05, 3)) if kind == Zone.SLOW else 0.0,
        width=draw(st.floats(0.1, 20)) if kind == Zone.LANE else 0.0,
        heading=draw(headings) if kind == Zone.PLACE else math.nan,
        rings=np.array(sizes, np.uint32),
        points=draw(flat),
    )


def zone_sets() -> st.SearchStrategy[tuple[Zone, ...]]:
    """Return a strategy for zones with different names."""
    return st.lists(zones(), max_size=3, unique_by=lambda zone: zone.name).map(tuple)


_WITH_RULES_BETWEEN_FIELDS = {
    LaserScan: _scans,
    MultiEchoLaserScan: _multi_echo_scans,
    Image: _images,
    OccupancyGrid: _grids,
    OccupancyGridUpdate: _grid_updates,
    LocalizationEstimate: _estimates,
    ExplorationStatus: _explorations,
    Plan: _plans,
    Zone: zones,
    Zones: lambda: _built(Zones, zones=zone_sets()),
    RecognizedObject: _recognized,
    RecognizedObjectArray: _recognized_arrays,
    WorldGeometry: _scenes,
    VisualObject: _visual_objects,
    LandmarkContribution: _contributions,
    VisualMapChange: _changes,
    SharedCells: _shared_cells,
}

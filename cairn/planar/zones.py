"""Zones on the map: the file MAP.zones.geojson, and their shapes.

The file is a GeoJSON FeatureCollection (RFC 7946), except that coordinates are x, y [m] in frame
map instead of longitude and latitude. Each feature is a zone:

- a Polygon, with holes, of `"zone": "keepout"`, or `"slow"` with its `speed` [m/s];
- a LineString of `"zone": "lane"` with its `width` [m]: a preferred lane;
- a Point of `"zone": "place"`, with the `heading` [rad] on arrival if that matters.

All have a `name`, which is unique.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from cairn.errors import CairnError
from cairn.limits.files import read_bounded
from cairn.limits.json import parse_json
from cairn.planar.polygons import crossing, edges_of, is_inside, ring_bounds
from cairn.schemas.cairn_nav_msgs import MAX_ZONES, ZONE_KINDS, Zone, Zones
from cairn.schemas.message import InvalidMessage
from cairn.system.files import explain_os_error

ZONE_FILE_BYTES: Final = 16 * 1024 * 1024
"""Largest zones file that is read [bytes]: more than `MAX_ZONES` zones of the most points need."""

Array = NDArray[np.float64]
Number = Annotated[float, Field(strict=True)]
Ignored = Annotated[Any, Field(exclude=True)]


def _flat(value: object) -> object:
    """Return a position without its height, which is 0 as programs of maps write it."""
    if isinstance(value, list) and len(value) == 3:
        if value[2]:
            raise ValueError(f"has the height {value[2]}, but zones are flat")
        return value[:2]
    return value


Position = Annotated[tuple[Number, Number], BeforeValidator(_flat)]


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class _Geometry(_Part):
    bbox: Ignored = None


class _Polygon(_Geometry):
    type: Literal["Polygon"] = "Polygon"
    coordinates: list[list[Position]]


class _LineString(_Geometry):
    type: Literal["LineString"] = "LineString"
    coordinates: list[Position]


class _Point(_Geometry):
    type: Literal["Point"] = "Point"
    coordinates: Position


def _single(value: object) -> object:
    """Return a geometry of several parts, of which there is one, as that part."""
    if isinstance(value, dict) and str(value.get("type", "")).startswith("Multi"):
        parts = value.get("coordinates")
        if not isinstance(parts, list) or len(parts) != 1:
            raise ValueError("has several parts; make each a feature of its own")
        return {"type": str(value["type"]).removeprefix("Multi"), "coordinates": parts[0]}
    return value


def _no_crs(_: object) -> object:
    """Refuse coordinates of the earth."""
    raise ValueError(
        "its coordinates are those of the earth; those of zones are x, y [m] in frame map: "
        "export it without them"
    )


class _Keepout(_Part):
    zone: Literal["keepout"] = "keepout"
    name: str


class _Slow(_Part):
    zone: Literal["slow"] = "slow"
    name: str
    speed: Number


class _Lane(_Part):
    zone: Literal["lane"] = "lane"
    name: str
    width: Number


class _Place(_Part):
    zone: Literal["place"] = "place"
    name: str
    heading: Number | None = None


class _Feature(_Part):
    type: Literal["Feature"] = "Feature"
    properties: Annotated[_Keepout | _Slow | _Lane | _Place, Field(discriminator="zone")]
    geometry: Annotated[
        Annotated[_Polygon | _LineString | _Point, Field(discriminator="type")],
        BeforeValidator(_single),
    ]
    id: Ignored = None
    bbox: Ignored = None


class _Collection(_Part):
    type: Literal["FeatureCollection"]
    features: list[Any] = Field(max_length=MAX_ZONES)
    name: Ignored = None
    bbox: Ignored = None
    crs: Annotated[Ignored, BeforeValidator(_no_crs)] = None


def read_zones(file: Path) -> tuple[Zone, ...]:
    """Return the zones in a file.

    Raises `CairnError` with the file, the feature and a remedy, `FileNotFoundError` if there is no
    such file.
    """
    try:
        data = read_bounded(file, ZONE_FILE_BYTES)
    except FileNotFoundError:
        raise
    except OSError as error:
        raise CairnError(f"{file}: cannot be read: {explain_os_error(error)}") from error
    try:
        return zones_in(data)
    except CairnError as error:
        raise CairnError(f"{file}: {error}") from error


class DamagedZones(CairnError):
    """The content of a zones file is not JSON."""


def zones_in(data: bytes) -> tuple[Zone, ...]:
    """Return the zones in the content of a file.

    Raises `DamagedZones`, or `CairnError` if a feature is invalid.
    """
    try:
        content = parse_json(data, ZONE_FILE_BYTES)
    except ValueError as error:
        raise DamagedZones(f"not a zones file: {error}; correct it, or remove the file") from error
    try:
        features = _Collection.model_validate(content).features
    except ValidationError as error:
        raise CairnError(f"not a GeoJSON FeatureCollection: {_fault(error)}; correct it") from error
    return zones_of(features)


def file_content(zones: Sequence[Zone]) -> bytes:
    """Return the content of a file with these zones: one line for each."""
    lines = ",\n".join(json.dumps(feature_of(zone), ensure_ascii=False) for zone in zones)
    middle = f"\n{lines}\n" if zones else ""
    return f'{{"type": "FeatureCollection", "features": [{middle}]}}\n'.encode()


def zones_of(features: Sequence[Any]) -> tuple[Zone, ...]:
    """Return the zones of GeoJSON features; raises `CairnError` with the first that is invalid."""
    zones = tuple(zone_of(feature, number) for number, feature in enumerate(features, start=1))
    try:
        return Zones(zones=zones).zones
    except InvalidMessage as error:
        raise CairnError(f"{_reason(error)}; rename or remove zones") from error


def zone_of(feature: Any, number: int = 1) -> Zone:
    """Return the zone of a GeoJSON feature; raises `CairnError`. `number` is for the error."""
    where = f"feature {number}{_name_in(feature)}"
    try:
        parsed = _Feature.model_validate(feature)
    except ValidationError as error:
        raise CairnError(f"{where}: {_fault(error)}; correct it") from error
    properties, geometry = parsed.properties, parsed.geometry
    wanted = {"lane": "LineString", "place": "Point"}.get(properties.zone, "Polygon")
    if geometry.type != wanted:
        raise CairnError(
            f"{where}: a {properties.zone} zone is a {wanted}, not a {geometry.type}; correct it"
        )
    rings = _rings_of(geometry, where)
    heading = properties.heading if isinstance(properties, _Place) else None
    try:
        zone = Zone(
            kind=_KIND_NUMBERS[properties.zone],
            name=properties.name,
            speed=properties.speed if isinstance(properties, _Slow) else 0.0,
            width=properties.width if isinstance(properties, _Lane) else 0.0,
            heading=math.nan if heading is None else heading,
            rings=np.array([len(ring) for ring in rings], np.uint32),
            points=np.array([point for ring in rings for point in ring], np.float64).ravel(),
        )
    except InvalidMessage as error:
        raise CairnError(f"{where}: {_reason(error)}; correct it") from error
    if wanted == "Polygon":
        _check_polygon(zone, where)
    return zone


def feature_of(zone: Zone) -> dict[str, Any]:
    """Return a zone as GeoJSON feature."""
    properties: dict[str, Any] = {"zone": ZONE_KINDS[zone.kind], "name": zone.name}
    points = points_of(zone).tolist()
    if zone.kind == Zone.PLACE:
        geometry: dict[str, Any] = {"type": "Point", "coordinates": points[0]}
        if not math.isnan(zone.heading):
            properties["heading"] = zone.heading
    elif zone.kind == Zone.LANE:
        geometry = {"type": "LineString", "coordinates": points}
        properties["width"] = zone.width
    else:
        if zone.kind == Zone.SLOW:
            properties["speed"] = zone.speed
        rings = [points[ring] for ring in ring_bounds(zone.rings)]
        # GeoJSON repeats the first corner of a ring at its end.
        geometry = {"type": "Polygon", "coordinates": [[*ring, ring[0]] for ring in rings]}
    return {"type": "Feature", "properties": properties, "geometry": geometry}


def points_of(zone: Zone) -> Array:
    """Return the points (n, 2) [m] of a zone."""
    return zone.points.reshape(-1, 2)


def zone_edges(zone: Zone) -> Array:
    """Return the edges (n, 4) [m] of an area, or the parts of a lane."""
    return edges_of(points_of(zone), zone.rings, closed=zone.kind != Zone.LANE)


_KIND_NUMBERS: Final = {name: number for number, name in ZONE_KINDS.items()}


def _rings_of(geometry: _Polygon | _LineString | _Point, where: str) -> list[list[Position]]:
    if isinstance(geometry, _Point):
        return [[geometry.coordinates]]
    if isinstance(geometry, _LineString):
        return [geometry.coordinates]
    for ring in geometry.coordinates:
        if len(ring) < 4 or ring[0] != ring[-1]:
            raise CairnError(
                f"{where}: a ring of a Polygon has at least four positions, of which the last is "
                "the first one again; correct it"
            )
    return [ring[:-1] for ring in geometry.coordinates]


def _check_polygon(zone: Zone, where: str) -> None:
    if (at := crossing(zone_edges(zone))) is not None:
        raise CairnError(
            f"{where}: edges of the polygon cross or touch at ({at[0]:.2f}, {at[1]:.2f}); draw an "
            "outline in which no edge meets another, and no point is repeated"
        )
    outline, *holes = ring_bounds(zone.rings)
    points = points_of(zone)
    around = edges_of(points[outline], zone.rings[:1])
    for hole in holes:
        x, y = points[hole][0].tolist()
        if not is_inside(around, x, y):
            raise CairnError(
                f"{where}: the hole at ({x:.2f}, {y:.2f}) is outside the outline; remove it"
            )


def _name_in(feature: Any) -> str:
    properties = feature.get("properties") if isinstance(feature, dict) else None
    name = properties.get("name") if isinstance(properties, dict) else None
    return f" ({name[:80]!r})" if isinstance(name, str) and name else ""


def _reason(error: InvalidMessage) -> str:
    value = f" = {error.value}" if error.value else ""
    return f"{error.path}{value}: {error.reason}"


def _fault(error: ValidationError) -> str:
    first = error.errors(include_url=False, include_input=False)[0]
    unions = {"keepout", "slow", "lane", "place", "Polygon", "LineString", "Point"}
    key = ".".join(str(part) for part in first["loc"] if part not in unions)
    reason = first["msg"].lower()
    if first["type"] in ("model_type", "model_attributes_type"):
        reason = "it must be an object"
    return f"{key}: {reason}".removeprefix(": ")

"""Zones: the file beside the map, and what is refused."""

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, assume, given, settings

from cairn import CairnError
from cairn.client.navigation import find_place
from cairn.planar.polygons import crossing
from cairn.planar.zones import (
    feature_of,
    file_content,
    read_zones,
    zone_edges,
    zone_of,
    zones_in,
)
from cairn.schemas.cairn_nav_msgs import MAX_ZONE_POINTS, MAX_ZONES, Zone
from tests.schemas.arbitrary import zone_sets

SQUARE = [[0, 0], [2, 0], [2, 2], [0, 2], [0, 0]]


def feature(geometry: str, coordinates: Any, **properties: Any) -> dict[str, Any]:
    return {
        "type": "Feature",
        "properties": properties,
        "geometry": {"type": geometry, "coordinates": coordinates},
    }


KITCHEN = feature("Point", [7.5, 5.0], zone="place", name="kitchen", heading=1.5)
DOCK = feature("Point", [1.0, 1.0], zone="place", name="dock")
STAIRS = feature("Polygon", [SQUARE], zone="keepout", name="stairs")
RAMP = feature("Polygon", [SQUARE], zone="slow", name="ramp", speed=0.2)
AISLE = feature("LineString", [[0, 0], [5, 0]], zone="lane", name="aisle", width=0.8)


def collection(*features: Any) -> bytes:
    return json.dumps({"type": "FeatureCollection", "features": features}).encode()


@settings(suppress_health_check=list(HealthCheck))
@given(zone_sets())
def test_zones_are_read_as_they_were_written(
    tmp_path_factory: pytest.TempPathFactory, zones: tuple[Zone, ...]
) -> None:
    areas = [zone for zone in zones if zone.kind in (Zone.KEEPOUT, Zone.SLOW)]
    assume(all(crossing(zone_edges(zone)) is None and zone.rings.size == 1 for zone in areas))
    file = tmp_path_factory.getbasetemp() / "map.zones.geojson"
    file.write_bytes(file_content(zones))
    assert read_zones(file) == zones


def test_file_has_one_line_for_each_zone() -> None:
    zones = zones_in(collection(KITCHEN, STAIRS, RAMP, AISLE))
    lines = file_content(zones).decode().splitlines()
    assert [json.loads(line.rstrip(",")) for line in lines[1:-1]] == [KITCHEN, STAIRS, RAMP, AISLE]
    assert zones_in(file_content(())) == ()


def test_features_of_a_zone_are_geojson() -> None:
    hole = [[0.5, 0.5], [1.5, 0.5], [1.5, 1.5], [0.5, 1.5], [0.5, 0.5]]
    ring = feature("Polygon", [SQUARE, hole], zone="keepout", name="ring")
    assert feature_of(zone_of(ring)) == ring


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        (feature("Polygon", [SQUARE], zone="wall", name="a"), "feature 1 ('a'): properties"),
        (feature("Polygon", [SQUARE], zone="keepout"), "properties.name: field required"),
        (feature("Polygon", [SQUARE], zone="keepout", name="a", speed=1.0), "speed"),
        (feature("Polygon", [SQUARE], zone="slow", name="a"), "speed: field required"),
        (feature("Polygon", [SQUARE], zone="slow", name="a", speed=0.0), "0.05 to 3"),
        (feature("Polygon", [SQUARE], zone="slow", name="a", speed=True), "speed"),
        (feature("Polygon", [SQUARE], zone="slow", name="a", speed="0.2"), "speed"),
        (feature("Polygon", [SQUARE[:3]], zone="keepout", name="a"), "at least four positions"),
        (feature("Polygon", [SQUARE[:4]], zone="keepout", name="a"), "the first one again"),
        (feature("Polygon", [], zone="keepout", name="a"), "rings"),
        (
            feature(
                "Polygon", [[[0, 0], [2, 2], [2, 0], [0, 2], [0, 0]]], zone="keepout", name="a"
            ),
            "cross or touch at (1.00, 1.00)",
        ),
        (
            feature(
                "Polygon",
                [SQUARE, [[8, 8], [9, 8], [9, 9], [8, 8]]],
                zone="keepout",
                name="a",
            ),
            "outside the outline",
        ),
        (feature("LineString", [[0, 0]], zone="lane", name="a", width=1.0), "2 or more"),
        (feature("LineString", [[0, 0], [1, 1]], zone="lane", name="a", width=0), "width"),
        (feature("Point", [0, 0], zone="keepout", name="a"), "is a Polygon, not a Point"),
        (feature("Point", [2e5, 0], zone="place", name="a"), "at most 100000 m"),
        (feature("Point", [0, 0, 1], zone="place", name="a"), "height 1"),
        (feature("Point", [0, 0], zone="place", name="a", heading=9), "heading"),
        (feature("Point", [0, 0], zone="place", name=""), "1 to 64 characters"),
        (feature("Point", [0, 0], zone="place", name="x" * 65), "1 to 64 characters"),
        (feature("Point", [0, 0], zone="place", name="a\x1b[31m"), "control characters"),
        (feature("Point", [0, 0], zone="place", name="a,b"), "commas"),
        (feature("Point", [0, 0], zone="place", name="-a"), "begin with a letter"),
        (feature("Point", [0, 0], zone="place", name="3"), "begin with a letter"),
        (feature("Point", [0, 0], zone="place", name="nan"), "must not be a number"),
        ({**KITCHEN, "color": 1}, "color"),
        ("kitchen", "it must be an object"),
    ],
)
def test_invalid_feature_is_refused_with_its_number_and_reason(bad: Any, words: str) -> None:
    with pytest.raises(CairnError) as error:
        zones_in(collection(bad))
    assert "feature 1" in str(error.value)
    assert words in str(error.value)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "not a zones file"),
        (b"[1", "not a zones file"),
        (b"[]", "not a GeoJSON FeatureCollection"),
        (b'{"type": "FeatureCollection"}', "features: field required"),
        (b'{"type": "FeatureCollection", "features": [], "crs": 1}', "crs"),
        (b"[" * 2000, "not a zones file"),
        (collection(KITCHEN, KITCHEN), "kitchen"),
        (collection(*[1] * (MAX_ZONES + 1)), "at most 200"),
        (
            collection(
                feature(
                    "LineString", [[0, 0]] * (MAX_ZONE_POINTS + 1), zone="lane", name="a", width=1
                )
            ),
            "at most 1000",
        ),
    ],
)
def test_invalid_file_is_refused_with_its_name(tmp_path: Path, content: bytes, words: str) -> None:
    file = tmp_path / "map.zones.geojson"
    file.write_bytes(content)
    with pytest.raises(CairnError) as error:
        read_zones(file)
    assert str(file) in str(error.value)
    assert words in str(error.value)


def test_missing_file_and_device_are_distinguished(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        read_zones(tmp_path / "none.geojson")
    with pytest.raises(CairnError, match="it is a device"):
        read_zones(Path("/dev/zero"))


def test_place_is_found_by_its_name() -> None:
    zones = zones_in(collection(KITCHEN, DOCK, STAIRS))
    assert find_place(zones, "kitchen") == (7.5, 5.0, 1.5)
    assert find_place(zones, "dock") == (1.0, 1.0, 0.0)


def test_unknown_place_is_refused_with_those_that_there_are() -> None:
    zones = zones_in(collection(KITCHEN, DOCK, STAIRS))
    with pytest.raises(CairnError, match=r"stairs: no such place on the map; .* dock, kitchen"):
        find_place(zones, "stairs")
    with pytest.raises(CairnError, match="none"):
        find_place((), "kitchen")

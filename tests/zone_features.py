"""Zones for tests, as GeoJSON features."""

from typing import Any

Box = tuple[float, float, float, float]
"""x and y [m] of two opposite corners."""


def area(kind: str, box: Box, name: str = "area", **properties: float) -> dict[str, Any]:
    """Return a keepout or slow zone that covers a box."""
    x0, y0, x1, y1 = box
    ring = [[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]]
    return _feature(kind, name, "Polygon", [ring], properties)


def lane(*points: tuple[float, float], width: float, name: str = "lane") -> dict[str, Any]:
    """Return a preferred lane."""
    return _feature("lane", name, "LineString", [list(point) for point in points], {"width": width})


def place(name: str, x: Any, y: Any, **properties: float) -> dict[str, Any]:
    """Return a named place."""
    return _feature("place", name, "Point", [x, y], properties)


def _feature(
    kind: str, name: str, geometry: str, coordinates: Any, properties: dict[str, float]
) -> dict[str, Any]:
    return {
        "type": "Feature",
        "properties": {"zone": kind, "name": name, **properties},
        "geometry": {"type": geometry, "coordinates": coordinates},
    }

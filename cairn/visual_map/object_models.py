"""Object models in the visual map's file: reads, adds and removes them."""

from __future__ import annotations

import math
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from cairn.errors import CairnError
from cairn.limits.images import decode_image
from cairn.vision.features import DESCRIPTOR, Features
from cairn.vision.object_model import ModelView, ObjectModel
from cairn.visual_map.sqlite_file import (
    MOST_ID,
    MapFileError,
    at_rest,
    check_row,
    connect,
    connect_unchecked,
    explained_errors,
    row_checksum,
    transaction,
)

Row = tuple[Any, ...]
Size = tuple[float, float]

_LONGEST_NAME = 100
_ATTEMPTS = 5

# Numbers are stored as in memory, little-endian.
_NUMBER: Final = np.dtype("<f4")
_MOST_PIXELS: Final = 100_000_000  # of all pictures of a small map
_PIXELS_OF_BYTE: Final = 20  # of a larger one: a picture in PNG format has 1 to 3 pixels in a byte
_MOST_SIDE: Final = 2**15 - 1  # [px], limit of OpenCV's remapping


@dataclass(frozen=True)
class ObjectModels:
    """All object models of a map; `revision` increases with every change of them."""

    revision: int
    models: tuple[ObjectModel, ...]

    def named(self, name: str) -> ObjectModel | None:
        """Return the model of that name, None if it does not exist."""
        return next((model for model in self.models if model.name == name), None)


def read_models(path: Path, *, pictures: bool = True) -> ObjectModels:
    """Read all object models of a map, by identifier.

    Without `pictures`, the pictures of the views are empty (0 x 0): they are large, and the
    recognizer does not need them. Raises `MapFileError`, which names the file, the defect and the
    remedy.
    """
    for _ in range(_ATTEMPTS):
        before = _state(path)
        with closing(connect(path, read_only=True)) as connection, explained_errors(path):
            models = _read(path, connection, pictures)
        if before == _state(path):
            return models
    raise MapFileError(f"{path} keeps changing while it is read. Try again later.")


def read_revision(path: Path) -> int:
    """Read `ObjectModels.revision` alone, quickly; raise `MapFileError` as `read_models`."""
    with connect_unchecked(path) as connection:
        before_format_2 = not connection.execute(
            "SELECT count(*) FROM sqlite_schema WHERE name = 'taught_changes'"
        ).fetchone()[0]
        return 0 if before_format_2 else _revision(connection)


def read_model_name(path: Path, object_id: int) -> str | None:
    """Read the name of an object model, None if it does not exist; raise `MapFileError`."""
    with connect_unchecked(path) as connection:
        row = connection.execute(
            "SELECT name FROM taught_objects WHERE object_id = ?", (object_id,)
        ).fetchone()
    return str(row[0]) if row else None


def add_views(path: Path, name: str, views: Sequence[ModelView], size: Size | None = None) -> int:
    """Add views to the object model of that name, or a new model; return its identifier.

    If a landmark has this name, a new model takes the landmark's identifier; otherwise a new one
    that was never used. `size` (width, height [m]) is stored if it is given. Raises `MapFileError`
    if the file cannot be written, `CairnError` if name or size is not valid, or if several
    landmarks have the name.
    """
    check_name(name)
    if size is not None:
        try:
            size_from_row(*size)
        except ValueError as error:
            raise CairnError(
                f"{name}: {error}. Give width and height in meters, above 0."
            ) from None
    with _changing(path) as connection:
        known = connection.execute(
            "SELECT object_id FROM taught_objects WHERE name = ?", (name,)
        ).fetchone()
        if known is None and not views:
            raise _unknown(path, name, connection)
        object_id = int(known[0]) if known else _new_id(path, name, connection)
        if known is None:
            connection.execute(
                "INSERT INTO taught_objects (object_id, name) VALUES (?, ?)", (object_id, name)
            )
        if size is not None:
            connection.execute(
                "UPDATE taught_objects SET width_m = ?, height_m = ? WHERE object_id = ?",
                (*size, object_id),
            )
        connection.executemany(
            "INSERT INTO taught_views (object_id, width, height, points, scales, angles, "
            "descriptors, picture, checksum) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)",
            (view_row(object_id, view) for view in views),
        )
    return object_id


def remove_model(path: Path, name: str) -> int:
    """Remove an object model and return its identifier; its landmark stays in the map.

    Raises `MapFileError` if the file cannot be written, `CairnError` if there is no such model.
    """
    with _changing(path) as connection:
        known = connection.execute(
            "SELECT object_id FROM taught_objects WHERE name = ?", (name,)
        ).fetchone()
        if known is None:
            raise _unknown(path, name, connection)
        for table in ("taught_views", "taught_objects"):
            connection.execute(f"DELETE FROM {table} WHERE object_id = ?", known)
    return int(known[0])


@contextmanager
def _changing(path: Path) -> Iterator[sqlite3.Connection]:
    with closing(connect(path)) as connection, transaction(path, connection):
        yield connection
        connection.execute("UPDATE taught_changes SET number = number + 1")


def _read(path: Path, connection: sqlite3.Connection, pictures: bool) -> ObjectModels:
    connection.execute("BEGIN")  # one consistent state of all tables
    models = []
    pixels, most = 0, max(_MOST_PIXELS, _PIXELS_OF_BYTE * path.stat().st_size)
    picture = "picture" if pictures else "NULL"
    for object_id, name, width, height in connection.execute(
        "SELECT object_id, name, width_m, height_m FROM taught_objects ORDER BY object_id"
    ).fetchall():
        rows = connection.execute(
            f"SELECT object_id, width, height, points, scales, angles, descriptors, {picture}, "
            "checksum FROM taught_views WHERE object_id = ? ORDER BY view_id",
            (object_id,),
        )
        try:
            if not 0 <= object_id <= MOST_ID:
                raise ValueError(f"its identifier is not from 0 to {MOST_ID}")
            views = []
            for row in rows:
                views.append(view_from_row(row, pictures))
                pixels += views[-1].picture.size
                if pixels > most:
                    raise ValueError(
                        f"its pictures and those before it have more than {most / 1e6:.0f} "
                        "megapixels, the limit for a file of its size"
                    )
            if not views:
                raise ValueError("it has no view")
            models.append(ObjectModel(object_id, name, size_from_row(width, height), tuple(views)))
        except (ValueError, TypeError) as error:
            raise MapFileError(
                f"{path}: the object model {name!r} is damaged: {error}. Restore a copy of the "
                "file, or remove the object (`cairn object remove`) and teach it again."
            ) from error
    return ObjectModels(_revision(connection), tuple(models))


def _revision(connection: sqlite3.Connection) -> int:
    row = connection.execute("SELECT number FROM taught_changes").fetchone()
    if row is None or not isinstance(row[0], int):
        raise ValueError("the revision of the object models is missing")
    return int(row[0])


def _new_id(path: Path, name: str, connection: sqlite3.Connection) -> int:
    same = connection.execute(
        "SELECT object_id FROM objects WHERE name = ? ORDER BY object_id", (name,)
    ).fetchall()
    if len(same) > 1:
        numbers = ", ".join(str(row[0]) for row in same)
        raise CairnError(
            f"{path}: landmarks {numbers} are all named {name!r}, so the name is ambiguous. Give "
            "another name."
        )
    if same:
        _check_free(path, name, int(same[0][0]), connection)
        return int(same[0][0])
    last = connection.execute(
        "SELECT max(coalesce((SELECT max(object_id) FROM objects), 0), "
        "coalesce((SELECT max(object_id) FROM changes), 0), "
        "coalesce((SELECT seq FROM sqlite_sequence WHERE name = 'taught_objects'), 0))"
    ).fetchone()
    return int(last[0]) + 1


def _check_free(path: Path, name: str, object_id: int, connection: sqlite3.Connection) -> None:
    taught = connection.execute(
        "SELECT name FROM taught_objects WHERE object_id = ?", (object_id,)
    ).fetchone()
    if taught is not None:
        raise CairnError(
            f"{path}: object {object_id} is landmark {name!r}, but its model is {taught[0]!r}. Use "
            "that name, or give another one."
        )


def check_name(name: str) -> None:
    """Raise `CairnError` if this is not a valid name of an object."""
    if not name.strip() or name != name.strip() or not name.isprintable():
        raise CairnError(
            f"{name!r} is not a valid name of an object: give printable characters, without spaces "
            "at either end"
        )
    if len(name) > _LONGEST_NAME:
        raise CairnError(
            f"{name[:20]!r}... has {len(name)} characters: give a name of at most {_LONGEST_NAME}"
        )


def _unknown(path: Path, name: str, connection: sqlite3.Connection) -> CairnError:
    rows = connection.execute("SELECT name FROM taught_objects ORDER BY name").fetchall()
    known = ", ".join(str(row[0]) for row in rows) or "none"
    return CairnError(f"{path}: object model {name!r} does not exist; available: {known}.")


def _state(path: Path) -> tuple[int, int] | None:
    """Return time and size of a file at rest, None if it is not at rest.

    A file at rest is read without a lock, because its folder may be read-only.
    """
    with explained_errors(path):
        if not (path.is_file() and at_rest(path)):
            return None
        state = path.stat()
    return state.st_mtime_ns, state.st_size


def view_row(object_id: int, view: ModelView) -> Row:
    """Return the row of table `taught_views` for a view, without its identifier."""
    features = view.features
    values = (
        object_id,
        view.width,
        view.height,
        features.points.astype(_NUMBER).tobytes(),
        features.scales.astype(_NUMBER).tobytes(),
        features.angles.astype(_NUMBER).tobytes(),
        features.descriptors.tobytes(),
    )
    return (*values, cv2.imencode(".png", view.picture)[1].tobytes(), row_checksum(values))


def view_from_row(row: Row, with_picture: bool) -> ModelView:
    """Return the view of a row that `view_row` made; raise `ValueError` if it is damaged."""
    width, height = (_side(value) for value in row[1:3])
    features = _features(*row[3:7])
    beyond = (features.points < -0.5) | (features.points > (width - 0.5, height - 0.5))
    if beyond.any():
        raise ValueError("a feature is outside of its picture")
    picture = _picture(row[7], width, height) if with_picture else np.zeros((0, 0), np.uint8)
    check_row(row[:7], row[8])
    return ModelView(width, height, features, picture)


def size_from_row(width: Any, height: Any) -> tuple[float, float] | None:
    """Return an object's size [m]; raise `ValueError` if it is not valid."""
    if width is None and height is None:
        return None
    size = float(width or 0), float(height or 0)
    if not all(math.isfinite(side) and side > 0 for side in size):
        raise ValueError(f"its size {width} x {height} is not above 0 m")
    return size


def _features(points: Any, scales: Any, angles: Any, descriptors: Any) -> Features:
    number = len(_blob(scales, None, "scales")) // _NUMBER.itemsize
    found = Features(
        np.frombuffer(_blob(points, 8 * number, "points"), _NUMBER).reshape(number, 2),
        np.frombuffer(_blob(scales, 4 * number, "scales"), _NUMBER),
        np.frombuffer(_blob(angles, 4 * number, "angles"), _NUMBER),
        np.frombuffer(_blob(descriptors, DESCRIPTOR * number, "descriptors"), np.uint8).reshape(
            number, DESCRIPTOR
        ),
    )
    if not (
        np.isfinite(found.points).all()
        and np.isfinite(found.angles).all()
        and np.isfinite(found.scales).all()
        and (found.scales > 0).all()
    ):
        raise ValueError("a feature's position, scale or angle is not a number")
    return found


def _blob(value: Any, length: int | None, what: str) -> bytes:
    if not isinstance(value, bytes) or (length is not None and len(value) != length):
        held = f"{len(value)} bytes" if isinstance(value, bytes) else type(value).__name__
        raise ValueError(f"its {what} are {held} instead of {length} bytes")
    return value


def _picture(value: Any, width: int, height: int) -> NDArray[np.uint8]:
    data = _blob(value, None, "pixels")
    try:
        header, pixels = decode_image("its picture", data)
    except CairnError as error:
        raise ValueError(f"its picture is not a PNG image: {error}") from error
    if header.format != "PNG" or pixels.shape != (height, width) or pixels.dtype != np.uint8:
        raise ValueError(f"its picture is not a PNG image of {width} x {height} pixels")
    return pixels


def _side(value: Any) -> int:
    if not isinstance(value, int) or not 1 <= value <= _MOST_SIDE:
        raise ValueError(f"its width or height {value} is not from 1 to {_MOST_SIDE} pixels")
    return value

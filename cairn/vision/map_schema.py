"""The tables of the visual map's file, as they have grown from format to format."""

from __future__ import annotations

from typing import Final

# Each table's columns in the order in which they are read. What is added to a table is added by
# the last format, at its end, so that files that exist can be upgraded by the same statements.

_MAP: Final = (
    "CREATE TABLE origin (source TEXT NOT NULL, digest TEXT NOT NULL, created_s REAL NOT NULL)",
    """CREATE TABLE objects (
        object_id INTEGER PRIMARY KEY, name TEXT NOT NULL,
        x REAL, y REAL, xx REAL, xy REAL, yy REAL,
        reliability REAL NOT NULL, state INTEGER NOT NULL, evidence_count INTEGER NOT NULL,
        candidate_x REAL, candidate_y REAL,
        candidate_xx REAL, candidate_xy REAL, candidate_yy REAL,
        candidate_reliability REAL, candidate_sightings INTEGER
    )""",
    """CREATE TABLE changes (
        version INTEGER PRIMARY KEY, stamp_ns INTEGER NOT NULL, object_id INTEGER NOT NULL,
        kind TEXT NOT NULL, old_x REAL, old_y REAL, new_x REAL, new_y REAL,
        reliability REAL NOT NULL, reason TEXT NOT NULL
    )""",
    """CREATE TABLE evidence (
        stamp_ns INTEGER NOT NULL, object_id INTEGER NOT NULL,
        similarity REAL NOT NULL, verdict TEXT NOT NULL, distance REAL NOT NULL,
        x REAL NOT NULL, y REAL NOT NULL, xx REAL NOT NULL, xy REAL NOT NULL, yy REAL NOT NULL,
        robot_x REAL NOT NULL, robot_y REAL NOT NULL, robot_theta REAL NOT NULL,
        healthy INTEGER NOT NULL, counted INTEGER NOT NULL,
        reliability REAL NOT NULL, candidate_reliability REAL, state INTEGER NOT NULL
    )""",
    "CREATE INDEX evidence_of_object ON evidence (object_id, stamp_ns)",
)

# Numbers of objects are never used again, else a new object were taken for one that was removed:
# AUTOINCREMENT. `taught_changes` holds one row; readers see from it whether to read again.
_TAUGHT: Final = (
    """CREATE TABLE taught_objects (
        object_id INTEGER PRIMARY KEY AUTOINCREMENT, name TEXT NOT NULL UNIQUE,
        width_m REAL, height_m REAL
    )""",
    """CREATE TABLE taught_views (
        view_id INTEGER PRIMARY KEY AUTOINCREMENT, object_id INTEGER NOT NULL,
        width INTEGER NOT NULL, height INTEGER NOT NULL,
        points BLOB NOT NULL, scales BLOB NOT NULL, angles BLOB NOT NULL,
        descriptors BLOB NOT NULL, picture BLOB NOT NULL
    )""",
    "CREATE INDEX views_of_object ON taught_views (object_id, view_id)",
    "CREATE TABLE taught_changes (number INTEGER NOT NULL)",
    "INSERT INTO taught_changes VALUES (0)",
)

# From where an object is usually recognized: JSON, "" for nothing known.
_VIEWPOINTS: Final = ("ALTER TABLE objects ADD COLUMN viewpoints TEXT NOT NULL DEFAULT ''",)

# What a row is known to be whole by; NULL in rows that older programs wrote. That of a view does
# not cover its picture, which has one of its own and is not always read.
_CHECKSUMS: Final = (
    "ALTER TABLE objects ADD COLUMN checksum INTEGER",
    "ALTER TABLE taught_views ADD COLUMN checksum INTEGER",
)

FORMATS: Final[tuple[tuple[str, ...], ...]] = (_MAP, _TAUGHT + _VIEWPOINTS, _CHECKSUMS)
"""What each format adds to the one before, the first to an empty file."""

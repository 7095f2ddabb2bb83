"""Bounds the evidence in a visual map: the newest rows stay, older ones become summaries.

A summary counts the removed rows of one landmark by verdict and by whether they changed the
landmark. The rule that repairs the map never reads old evidence, so it does not depend on this.
"""

from __future__ import annotations

import sqlite3
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Final

from cairn.visual_map.landmarks import EvidenceVerdict

Row = tuple[Any, ...]
"""A row of table `evidence`."""

MOST_COUNTED: Final = 750
"""Newest rows kept of one landmark that changed it: some hours of a robot's daily work."""
MOST_UNCOUNTED: Final = 250
"""Newest rows kept of one landmark that did not: a parked robot writes five each second."""
MOST_ROWS: Final = 50_000
"""Newest rows kept of all landmarks: about 10 MB."""
_SLACK: Final = 1.2  # rows are removed when there are so many times more, many at a time
_MOST_AT_ONCE: Final = 5_000  # rows removed by one commit, so that it does not take long

_STAMP, _OBJECT, _VERDICT, _COUNTED, _RELIABILITY = 0, 1, 3, 14, 15  # columns of table `evidence`


@dataclass(frozen=True)
class EvidenceSummary:
    """Removed evidence about one landmark with one verdict.

    `counted`: it changed the landmark, whose reliability after the newest piece is `reliability`.
    """

    object_id: int
    verdict: EvidenceVerdict
    counted: bool
    pieces: int
    first_ns: int
    last_ns: int
    reliability: float

    def merged(self, later: EvidenceSummary) -> EvidenceSummary:
        """Return the summary of both, of which `later` is about newer evidence."""
        return replace(
            later,
            pieces=self.pieces + later.pieces,
            first_ns=min(self.first_ns, later.first_ns),
            last_ns=max(self.last_ns, later.last_ns),
        )


class EvidenceSummaries:
    """Summaries of many rows, by landmark, verdict and whether they counted."""

    def __init__(self) -> None:
        self._summaries: dict[tuple[int, EvidenceVerdict, bool], EvidenceSummary] = {}

    def __bool__(self) -> bool:
        return bool(self._summaries)

    def __iter__(self) -> Iterator[EvidenceSummary]:
        return iter(self._summaries.values())

    def add(self, summary: EvidenceSummary) -> None:
        """Add a summary of newer evidence."""
        key = (summary.object_id, summary.verdict, summary.counted)
        known = self._summaries.get(key)
        self._summaries[key] = summary if known is None else known.merged(summary)

    def add_row(self, row: Row) -> None:
        """Add a row of table `evidence`, which is newer than those before.

        Raises `KeyError`, `TypeError` or `ValueError` if it is not valid.
        """
        stamp = int(row[_STAMP])
        verdict, counted = EvidenceVerdict[row[_VERDICT]], bool(row[_COUNTED])
        self.add(
            EvidenceSummary(
                int(row[_OBJECT]), verdict, counted, 1, stamp, stamp, float(row[_RELIABILITY])
            )
        )

    def clear(self) -> None:
        """Remove all summaries."""
        self._summaries.clear()


class EvidenceHistory:
    """Table `evidence` of an open map, and its summaries, within the bounds of this module."""

    def __init__(self, connection: sqlite3.Connection) -> None:
        self._connection = connection
        self._rows: Counter[tuple[int, int]] | None = None  # by landmark and `counted`

    def append(self, rows: Sequence[Row], summaries: Iterable[EvidenceSummary] = ()) -> None:
        """Append rows, and summaries of older ones, within the caller's transaction."""
        self._write_summaries(summaries)
        if not rows:
            return
        if self._rows is None:
            self._rows = self._count_rows()
        self._connection.executemany(
            f"INSERT INTO evidence VALUES ({', '.join('?' * len(rows[0]))})", rows
        )
        added = Counter((row[_OBJECT], row[_COUNTED]) for row in rows)
        self._rows += added
        for object_id, counted in added:
            most = MOST_COUNTED if counted else MOST_UNCOUNTED
            here = self._rows[object_id, counted]
            if here > most * _SLACK:
                self._summarize(
                    "WHERE object_id = ? AND counted = ?", (object_id, counted), here - most
                )
        excess = self._rows.total() - MOST_ROWS
        if excess > MOST_ROWS * (_SLACK - 1.0):
            self._summarize("", (), excess)

    def rolled_back(self) -> None:
        """Count the rows again: what was appended last is not in the file."""
        self._rows = None

    def summaries_of(self, object_id: int) -> list[EvidenceSummary]:
        """Return the summaries of a landmark; raises `ValueError` if one is invalid."""
        rows = self._connection.execute(
            "SELECT object_id, verdict, counted, pieces, first_ns, last_ns, reliability "
            "FROM evidence_summaries WHERE object_id = ? ORDER BY verdict, counted",
            (object_id,),
        ).fetchall()
        return list(map(_summary_of, rows))

    def _count_rows(self) -> Counter[tuple[int, int]]:
        rows = self._connection.execute(
            "SELECT object_id, counted, count(*) FROM evidence GROUP BY object_id, counted"
        )
        return Counter({(int(one), int(counted)): int(count) for one, counted, count in rows})

    def _summarize(self, where: str, values: tuple[int, ...], count: int) -> None:
        """Replace the `count` oldest of the rows that a condition selects by their summaries."""
        assert self._rows is not None
        rows = self._connection.execute(
            f"SELECT *, rowid FROM evidence {where} ORDER BY rowid LIMIT ?",
            (*values, min(count, _MOST_AT_ONCE)),
        ).fetchall()
        summaries = EvidenceSummaries()
        for row in rows:
            with suppress(KeyError, TypeError, ValueError):  # a damaged row
                summaries.add_row(row)
        self._write_summaries(summaries)
        self._connection.executemany(
            "DELETE FROM evidence WHERE rowid = ?", [(row[-1],) for row in rows]
        )
        self._rows -= Counter((row[_OBJECT], row[_COUNTED]) for row in rows)

    def _write_summaries(self, summaries: Iterable[EvidenceSummary]) -> None:
        for summary in summaries:
            key = (summary.object_id, summary.verdict.name, int(summary.counted))
            known = self._connection.execute(
                "SELECT object_id, verdict, counted, pieces, first_ns, last_ns, reliability "
                "FROM evidence_summaries WHERE object_id = ? AND verdict = ? AND counted = ?",
                key,
            ).fetchone()
            now = summary
            with suppress(ValueError):  # a damaged row is replaced
                now = summary if known is None else _summary_of(known).merged(summary)
            self._connection.execute(
                "INSERT OR REPLACE INTO evidence_summaries VALUES (?, ?, ?, ?, ?, ?, ?)",
                (*key, now.pieces, now.first_ns, now.last_ns, now.reliability),
            )


def _summary_of(row: Row) -> EvidenceSummary:
    object_id, verdict, counted, pieces, first_ns, last_ns, reliability = row
    try:
        return EvidenceSummary(
            int(object_id),
            EvidenceVerdict[verdict],
            bool(counted),
            int(pieces),
            int(first_ns),
            int(last_ns),
            float(reliability),
        )
    except (TypeError, ValueError, KeyError, OverflowError) as error:
        raise ValueError(f"summary of the evidence about object {object_id}: {error}") from error

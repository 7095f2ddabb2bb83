"""What a recording holds, in figures: its streams and its scanner."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from cairn import SECOND
from cairn.components.replay.recording import Recording


def contents_of(recording: Recording) -> dict[str, Any]:
    """Streams, the scanner, whether there are odometry and true poses, and what was lost."""
    streams = {
        "scan": recording.scans(),
        "odom": recording.odometry(),
        "objects": recording.sightings(),
        "truth": recording.truth(),
        "images": recording.images(),
    }
    rows = []
    for source in recording.sources():
        stream = streams.get(source.kind or "")
        timing = _timing(stream.stamps) if stream is not None else {"span_s": None, "rate_hz": None}
        rows.append(
            {
                "replayed_as": source.kind,
                "topic": source.topic,
                "type": source.type,
                "count": source.count,
                **timing,
            }
        )
    return {
        "streams": rows,
        "scanner": _scanner(recording),
        "odometry": streams["odom"] is not None,
        "true_poses": streams["truth"] is not None,
        "notes": list(recording.notes()),
    }


def _timing(stamps: Sequence[int]) -> dict[str, float | None]:
    span = (stamps[-1] - stamps[0]) / SECOND if stamps else 0.0
    return {"span_s": span, "rate_hz": (len(stamps) - 1) / span if span > 0 else None}


def _scanner(recording: Recording) -> dict[str, Any] | None:
    """The scanner as its first scan describes it."""
    scans = recording.scans()
    if scans is None:
        return None
    scan = scans.messages[0]
    return {
        "beams": int(scan.ranges.size),
        "first_deg": math.degrees(scan.angle_min),
        "last_deg": math.degrees(scan.angle_min + scan.angle_increment * (scan.ranges.size - 1)),
        "increment_deg": math.degrees(scan.angle_increment),
        "range_min_m": float(scan.range_min),
        "range_max_m": float(scan.range_max),
    }

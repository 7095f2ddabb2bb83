"""Fixtures of the replay tests: the recordings in the repository, and small ones written here."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from cairn import Component
from cairn.testing.lockstep import ComponentHarness

DATA = Path(__file__).parents[2] / "data"
FR079 = DATA.parents[1] / "deploy" / "recordings" / "fr079_corrected.log.gz"
FR101 = DATA / "carmen" / "fr101_corrected.log.gz"
LEGS = DATA / "rosbags" / "leg_tracker_12s.bag"
OLD_BAG = DATA / "rosbags" / "laser_scan_splitter_v12.bag"

Write = Callable[..., Path]


def start(component: type[Component], start_s: float, **parameters: Any) -> ComponentHarness[Any]:
    """Run a replay component alone from a virtual time [s]."""
    return ComponentHarness(component, parameters, start_s=start_s)


def odom(t: float, x: float, speed: float = 1.0) -> str:
    return f"ODOM {x} 0 0 {speed} 0 0 {t:.6f} host {t:.6f}"


def flaser(t: float, x: float, ranges: tuple[float, ...] = (1.0,) * 180) -> str:
    words = " ".join(str(r) for r in ranges)
    return f"FLASER {len(ranges)} {words} {x + 0.1} 0 0 {x} 0 0 {t:.6f} host {t:.6f}"


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Writes lines to a log."""

    def written(*lines: str) -> Path:
        path = tmp_path / "run.log"
        path.write_text("".join(f"{line}\n" for line in lines))
        return path

    return written

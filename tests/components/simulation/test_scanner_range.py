"""A scanner that sees less far than its model."""

from collections.abc import Callable

import numpy as np
import pytest

from cairn import CairnError
from cairn.components.simulation.scanner import SimulatedScanner
from tests.components.simulation.stage import Simulation


def test_what_is_farther_away_is_no_return(begin: Callable[..., Simulation]) -> None:
    simulation = begin()
    simulation.drive(0.5, 0.0, 0.0)
    before = simulation.taken("scan")[-1]
    simulation.rerun(SimulatedScanner, rate=10, dropouts=0, farthest=2.5)
    simulation.taken("scan")
    simulation.drive(0.5, 0.0, 0.0)

    scans = [scan for scan in simulation.taken("scan") if scan.range_max == 2.5]

    assert scans
    assert np.isfinite(before.ranges).sum() > np.isfinite(scans[-1].ranges).sum() > 0
    for scan in scans:
        assert (scan.ranges[np.isfinite(scan.ranges)] <= 2.5).all()


def test_it_never_sees_farther_than_its_model(begin: Callable[..., Simulation]) -> None:
    simulation = begin()
    simulation.rerun(SimulatedScanner, model="PBS-03JN", dropouts=0, farthest=9.0)
    simulation.drive(0.5, 0.0, 0.0)

    assert {scan.range_max for scan in simulation.taken("scan")} == {3.0, 10.0}


def test_a_scanner_that_sees_nothing_is_refused(begin: Callable[..., Simulation]) -> None:
    with pytest.raises(CairnError, match=r"sees nothing nearer than 0\.2 m"):
        begin().rerun(SimulatedScanner, model="PBS-03JN", farthest=0.2)

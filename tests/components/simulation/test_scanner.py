"""Scanners measure as their data sheets specify, also in motion, with the configured faults."""

import math
from itertools import pairwise

import numpy as np
import pytest

from cairn.components.simulation.layout import SURFACES
from cairn.components.simulation.scanner import (
    MODELS,
    BeamPattern,
    SimulatedScannerConfig,
    simulate_sweep,
)
from cairn.components.simulation.world_file import Surface
from cairn.components.simulation.world_tracker import RayTargets
from cairn.planar.poses import Pose, compose, relative
from cairn.planar.scans import rays_of
from cairn.schemas.sensor_msgs import LaserScan

NONE = SimulatedScannerConfig(dropouts=0.0, dark_dropouts=0.0, dark_reach=1.0, glass_returns=0.0)
EVERYWHERE = (-math.pi, math.pi, 1)
# name: field of view [deg], steps, scans per second, least and largest range [m]
SHEETS = {
    "URG-04LX": (240, 682, 10, 0.06, 4.095),
    "URG-04LX-UG01": (240, 682, 10, 0.06, 5.6),
    "UTM-30LX": (270, 1081, 40, 0.1, 30),
    "UST-10LX": (270, 1081, 40, 0.06, 10),
    "UST-20LX": (270, 1081, 40, 0.06, 20),
    "PBS-03JN": (216, 121, 10, 0.2, 3),
}


def square(half: float, surface: Surface = "plain") -> RayTargets:
    """Four walls around the origin."""
    corners = [(-half, -half), (half, -half), (half, half), (-half, half), (-half, -half)]
    rows = [(*a, *b) for a, b in pairwise(corners)]
    surfaces = np.full(4, SURFACES[surface], np.uint8)
    return RayTargets(np.array(rows), surfaces, np.zeros((0, 3)))


def swept(
    name: str,
    around: RayTargets,
    faults: SimulatedScannerConfig = NONE,
    pose: Pose = (0, 0, 0),
    seed: int = 0,
) -> tuple[np.ndarray, BeamPattern]:
    beams = BeamPattern.of(MODELS[name], *EVERYWHERE)
    poses = np.tile(np.array(pose, float), (beams.angles.size, 1))
    return simulate_sweep(
        MODELS[name], beams, faults, poses, around, np.random.default_rng(seed)
    ), beams


def to_wall(beams: BeamPattern, half: float) -> np.ndarray:
    """The true ranges from the center of the square."""
    true: np.ndarray = half / np.maximum(np.abs(np.cos(beams.angles)), np.abs(np.sin(beams.angles)))
    return true


@pytest.mark.parametrize("name", SHEETS)
def test_models_agree_with_their_data_sheets(name: str) -> None:
    view, steps, rate, least, most = SHEETS[name]
    model = MODELS[name]

    assert math.degrees(model.last - model.first) == pytest.approx(view, abs=0.7)
    assert model.first == -model.last
    assert (model.steps, model.least, model.most) == (steps, least, most)
    assert model.turn_s == pytest.approx(1 / rate)
    assert BeamPattern.of(model, *EVERYWHERE).times[-1] == pytest.approx(
        view / 360 / rate, rel=0.01
    )


def test_only_the_configured_beams_are_measured() -> None:
    beams = BeamPattern.of(MODELS["UST-10LX"], math.radians(-90), math.radians(90), 3)

    assert math.degrees(beams.angles[0]) == pytest.approx(-90)
    assert math.degrees(beams.angles[-1]) == pytest.approx(90)
    assert np.diff(beams.angles) == pytest.approx(math.radians(0.75))
    assert beams.times[1] == pytest.approx(3 * 0.025 / 1440)


@pytest.mark.parametrize("name", SHEETS)
def test_noise_has_the_configured_deviation(name: str) -> None:
    model = MODELS[name]
    sweeps = [swept(name, square(1.5), seed=seed) for seed in range(20)]
    true = to_wall(sweeps[0][1], 1.5)
    stated = np.maximum(model.noise_m, model.noise_share * true)

    scaled = np.concatenate([(ranges - true) / stated for ranges, _ in sweeps])

    assert scaled.mean() == pytest.approx(0.0, abs=4 / math.sqrt(scaled.size))
    assert scaled.std() == pytest.approx(1.0, abs=4 / math.sqrt(2 * scaled.size))


def test_ranges_beyond_the_limit_are_infinite_and_too_near_ones_are_nan() -> None:
    far, _ = swept("UST-10LX", square(12.0))
    near, _ = swept("PBS-03JN", square(0.1))

    assert np.all(np.isposinf(far))
    assert np.all(np.isnan(near) | (near >= 0.2))
    assert np.isnan(near).mean() > 0.5


def test_beams_fail_as_often_as_configured() -> None:
    faults = NONE.model_copy(update={"dropouts": 0.1})
    failed = [np.isnan(swept("UST-10LX", square(2.0), faults, seed=n)[0]).mean() for n in range(10)]

    assert np.mean(failed) == pytest.approx(0.1, abs=0.012)


def test_dark_surfaces_have_less_range_and_fail_more_often() -> None:
    faults = NONE.model_copy(update={"dark_dropouts": 0.4, "dark_reach": 0.4})
    near, _ = swept("UST-10LX", square(2.0, "dark"), faults)
    far, _ = swept("UST-10LX", square(5.0, "dark"), faults)
    plain, _ = swept("UST-10LX", square(5.0), faults)

    assert np.isnan(near).mean() == pytest.approx(0.4, abs=0.06)
    assert not np.isfinite(far).any()
    assert np.isfinite(plain).all()


def test_most_beams_pass_through_glass() -> None:
    glass, wall = square(1.0, "glass"), square(3.0)
    both = RayTargets(
        np.vstack((glass.segments, wall.segments)),
        np.concatenate((glass.surfaces, wall.surfaces)),
        np.zeros((0, 3)),
    )
    ranges, beams = swept("UST-10LX", both, NONE.model_copy(update={"glass_returns": 0.2}))

    at_glass = np.abs(ranges - to_wall(beams, 1.0)) < 0.1
    behind = np.abs(ranges - to_wall(beams, 3.0)) < 0.1
    assert at_glass.mean() == pytest.approx(0.2, abs=0.05)
    assert np.all(at_glass | behind)


@pytest.mark.parametrize("turn", [1.5, -1.5])
def test_deskewed_scan_of_a_turning_robot_has_straight_walls(turn: float) -> None:
    model, mount, half = MODELS["UST-10LX"], (0.1, 0.05, 0.3), 3.0
    beams = BeamPattern.of(model, *EVERYWHERE)
    arcs = [compose((0.2, -0.4, 0.7), _arc(0.5, turn, time)) for time in beams.times.tolist()]
    poses = np.array([compose(base, mount) for base in arcs])

    ranges = simulate_sweep(model, beams, NONE, poses, square(half), np.random.default_rng(0))
    scan = LaserScan(
        angle_min=float(beams.angles[0]),
        angle_max=float(beams.angles[-1]),
        angle_increment=model.increment,
        time_increment=model.time_increment,
        range_min=model.least,
        range_max=model.most,
        ranges=ranges,
    )
    straight = _off_the_wall(
        rays_of(scan, mount, relative(arcs[0], arcs[-1])).points(), arcs[-1], half
    )
    bent = _off_the_wall(rays_of(scan, mount, (0.0, 0.0, 0.0)).points(), arcs[-1], half)

    assert np.sqrt(np.mean(straight**2)) < model.noise_m
    assert np.abs(straight).max() < 5 * model.noise_m
    assert (
        np.sqrt(np.mean(bent**2)) > 1.5 * model.noise_m
    )  # so the deskewing is what makes the walls straight


def _arc(forward: float, turn: float, seconds: float) -> Pose:
    half = (0.0, 0.0, 0.5 * turn * seconds)
    return compose(compose(half, (forward * seconds, 0.0, 0.0)), half)


def _off_the_wall(points: np.ndarray, base: Pose, half: float) -> np.ndarray:
    """The distance of points in the base's frame from the square [m], along the axes."""
    cosine, sine = math.cos(base[2]), math.sin(base[2])
    x = base[0] + cosine * points[:, 0] - sine * points[:, 1]
    y = base[1] + sine * points[:, 0] + cosine * points[:, 1]
    off: np.ndarray = np.maximum(np.abs(x), np.abs(y)) - half
    return off

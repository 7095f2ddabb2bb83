"""The base: limits, lag, stale commands, and odometry errors that match its covariance."""

import math

import numpy as np
import pytest

from cairn.components.simulation.base import Encoders, SimulatedBaseConfig, WheelDrive
from cairn.planar.poses import Pose, compose, relative, wrap
from tests.sweeps import sampled

STEP = 0.02
LIMITS = ERRORS = SimulatedBaseConfig()
NO_ERRORS = SimulatedBaseConfig(
    distance_scale_sd=0.0, turn_scale_sd=0.0, distance_error=0.0, turn_error=0.0, turn_per_meter=0.0
)


def driven(
    forward: float, turn: float, seconds: float, again: bool = True
) -> list[tuple[float, float]]:
    """The speeds after each step, for a command given once or repeatedly."""
    wheels, speeds = WheelDrive(LIMITS), []
    for number in range(round(seconds / STEP)):
        if again or number == 0:
            wheels.command(number * STEP, forward, turn)
        wheels.step((number + 1) * STEP, STEP)
        speeds.append((wheels.forward, wheels.turn))
    return speeds


@pytest.mark.parametrize("sign", [1, -1])
def test_speeds_and_accelerations_stay_within_limits(sign: int) -> None:
    speeds = np.array(driven(sign * 9.0, sign * 9.0, 3.0))
    changes = np.diff(np.vstack(([0.0, 0.0], speeds)), axis=0) / STEP

    assert speeds[-1] == pytest.approx([sign * LIMITS.speed, sign * LIMITS.turn])
    assert np.all(np.abs(speeds) <= np.array([LIMITS.speed, LIMITS.turn]) + 1e-12)
    assert np.abs(changes).max(axis=0) == pytest.approx(
        [LIMITS.acceleration, LIMITS.turn_acceleration]
    )


def test_command_takes_effect_after_the_lag() -> None:
    speeds = [forward for forward, _ in driven(0.5, 0.0, 0.2)]

    still = sum(speed == 0.0 for speed in speeds)
    assert still == math.ceil(LIMITS.lag_s / STEP) - 1


@pytest.mark.parametrize("commanded", [True, False])
def test_wheels_obey_after_the_clock_was_set_back(commanded: bool) -> None:
    wheels = WheelDrive(LIMITS)
    for number in range(50):
        wheels.command(100.0 + number * STEP, 0.5, 0.0)
        wheels.step(100.0 + number * STEP, STEP)
    assert wheels.forward > 0.3
    for number in range(50):
        if commanded:
            wheels.command(1.0 + number * STEP, 0.0, 0.0)
        wheels.step(1.0 + number * STEP, STEP)

    assert wheels.forward == 0.0


def test_wheels_stop_when_commands_are_stale() -> None:
    speeds = [forward for forward, _ in driven(0.5, 0.5, 2.0, again=False)]

    assert max(speeds) > 0.15
    stale = round((LIMITS.command_timeout_s + 0.04) / STEP)
    assert all(
        now <= before for before, now in zip(speeds[stale:], speeds[stale + 1 :], strict=False)
    )
    assert speeds[-1] == 0.0


def odometry(seed: int, errors: SimulatedBaseConfig) -> tuple[Encoders, Pose]:
    """Twelve meters in two bends: the measured pose and the true one."""
    encoders, true = Encoders(errors, np.random.default_rng(seed)), (0.0, 0.0, 0.0)
    for number in range(200):
        turned = 0.03 if number < 100 else -0.015
        encoders.measure(0.06, turned)
        true = compose(compose(compose(true, (0, 0, turned / 2)), (0.06, 0, 0)), (0, 0, turned / 2))
    return encoders, true


@pytest.mark.parametrize(
    "errors",
    sampled(
        [
            ERRORS,
            NO_ERRORS.model_copy(update={"distance_scale_sd": 0.03}),
            NO_ERRORS.model_copy(update={"turn_scale_sd": 0.05}),
            NO_ERRORS.model_copy(
                update={"distance_error": 0.02, "turn_error": 0.03, "turn_per_meter": 0.02}
            ),
        ]
    ),
)
def test_odometry_errors_match_their_covariance(errors: SimulatedBaseConfig) -> None:
    runs = [odometry(seed, errors) for seed in range(60)]
    off = np.array([(e.pose[0] - t[0], e.pose[1] - t[1], wrap(e.pose[2] - t[2])) for e, t in runs])
    stated = np.mean([encoders.covariance for encoders, _ in runs], axis=0)

    # 60 runs estimate a standard deviation to 9 %; three times that.
    deviations, said = np.sqrt(np.mean(off**2, axis=0)), np.sqrt(np.diag(stated))
    for found, expected in zip(deviations, said, strict=True):
        if expected > 1e-3:
            assert found == pytest.approx(expected, rel=0.3)
        else:
            assert found < 3e-3
    assert relative(runs[0][1], runs[0][0].pose) != (0.0, 0.0, 0.0)


def test_standing_wheels_measure_nothing() -> None:
    encoders = Encoders(ERRORS, np.random.default_rng(0))
    encoders.measure(0.0, 0.0)

    assert encoders.pose == (0.0, 0.0, 0.0)
    assert not encoders.covariance.any()

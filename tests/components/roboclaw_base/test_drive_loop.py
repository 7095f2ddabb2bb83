"""The drive loop with an emulated controller, in virtual time: what stops the wheels, and why."""

from collections.abc import Callable

import pytest

from cairn.components.roboclaw_base.client import (
    ControllerHandshake,
    UnusableControllerError,
    open_line,
)
from cairn.components.roboclaw_base.config import RoboclawBaseConfig
from cairn.components.roboclaw_base.drive_loop import DriveLoop
from cairn.components.roboclaw_base.health import ControllerHealth
from cairn.components.roboclaw_base.odometry import WheelStep
from cairn.driver.command_timeout import LatestCommand
from cairn.driver.device_thread import RETRY_S
from cairn.driver.errors import DeviceError, LinkLost
from tests.components.roboclaw_base.emulated_base import PARAMETERS
from tests.components.roboclaw_base.virtual_base import TakingTurns, VirtualBase, VirtualEvent
from tests.wording import words_in_order

_COMMAND_PERIOD_S = 0.02


class LoopRun:
    """A drive loop that takes turns with the test, and commands that are repeated meanwhile."""

    def __init__(self, base: VirtualBase, **parameters: object) -> None:
        values = {
            "acceleration": 4.0,
            "turn_acceleration": 20.0,
            "stall_s": 0.4,
            "device_timeout_s": 1.0,
            **parameters,
        }
        config = RoboclawBaseConfig.model_validate({**PARAMETERS, "port": "/dev/none", **values})
        self.base = base
        self.health = ControllerHealth()
        self.steps: list[WheelStep] = []
        self.device_errors: list[DeviceError] = []
        self.failures: list[Exception] = []
        self.ready: list[ControllerHandshake] = []
        self._command = LatestCommand(config.command_timeout_s)
        self._target = (0.0, 0.0)
        self._loop = DriveLoop(
            config.drive_settings(),
            base.open,
            self._command,
            self.health,
            on_ready=self.ready.append,
            on_step=self._note,
        )
        self._hold_up_s = 0.0
        self.held_up = False
        base.on_sleep = self._yield
        base.on_pause = self._pause
        self.restart()

    def hold_up(self, seconds: float) -> None:
        """Pause the loop, as on a busy computer."""
        self.held_up, self._hold_up_s = False, seconds

    def command(self, forward: float, turn: float = 0.0) -> None:
        self._target = (forward, turn)

    def drive(self, forward: float = 0.3) -> None:
        """Command a speed, and wait until the wheels turn."""
        self.command(forward)
        self.await_that(lambda: self.base.speed() > 0.7 * abs(forward))

    def await_that(self, condition: Callable[[], bool]) -> None:
        assert self.base.await_that(condition), (
            f"{self.health}, {self.device_errors}, {self.failures}"
        )

    def stop(self) -> None:
        self._stopping.set()
        assert self.base.await_that(lambda: self._thread.ended), "the loop does not stop"

    def restart(self) -> None:
        self._stopping = VirtualEvent(self.base)
        self._thread = TakingTurns(self._run)

    def _run(self) -> None:
        """Do what `DeviceThread` does."""
        while not self._stopping.is_set():
            try:
                self._loop.serve(self._stopping)
            except DeviceError as error:
                self.device_errors.append(error)
            except Exception as error:
                self.failures.append(error)
                return
            self._stopping.wait(RETRY_S)

    def _yield(self) -> None:
        self._thread.yield_turn()
        self._repeat_command()

    def _pause(self) -> None:
        if self._thread.ended:
            self.base.pass_time(_COMMAND_PERIOD_S)
        self._thread.take_turn()

    def _note(self, step: WheelStep) -> None:
        self.steps.append(step)
        while self._hold_up_s > 0.0:
            self.base.pass_time(_COMMAND_PERIOD_S)
            self._repeat_command()
            self._hold_up_s -= _COMMAND_PERIOD_S
            self.held_up = True

    def _repeat_command(self) -> None:
        self._command.set(self.base.monotonic(), *self._target)

    def __enter__(self) -> "LoopRun":
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()


@pytest.fixture
def base(monkeypatch: pytest.MonkeyPatch) -> VirtualBase:
    return VirtualBase(monkeypatch)


def test_stopped_loop_leaves_the_wheels_at_rest(base: VirtualBase) -> None:
    with LoopRun(base) as run:
        run.drive()
        run.stop()

        assert not base.turns()
        assert base.device.timeouts == 0  # the driver stopped them


def test_blocked_wheel_switches_the_motors_off(base: VirtualBase) -> None:
    with LoopRun(base) as run:
        run.drive()
        base.device.controller.set_fault(1, "stalled")
        run.await_that(lambda: run.health.wheel_fault is not None)

        assert "left wheel" in str(run.health.wheel_fault)
        assert base.await_stand(1.0)
        base.device.controller.set_fault(1, None)
        count = len(run.steps)
        run.await_that(lambda: len(run.steps) > count + 20)
        assert not base.turns(), "it started moving by itself"


def test_reversed_encoder_is_detected_before_the_wheel_is_fast(
    base: VirtualBase,
) -> None:
    base.device.controller.set_fault(2, "encoder_reversed")
    with LoopRun(base) as run:
        run.command(0.2)
        run.await_that(lambda: run.health.wheel_fault is not None)

        assert "it counts against its motor" in str(run.health.wheel_fault)
        assert base.await_stand(1.0)
        assert base.fastest_since(0.0) < 0.4


def test_unplugged_encoder_does_not_make_the_wheel_run_away(
    base: VirtualBase,
) -> None:
    with LoopRun(base) as run:
        run.drive(0.2)
        base.device.controller.set_fault(1, "encoder_off")
        run.await_that(lambda: run.health.wheel_fault is not None)

        assert "stands still" in str(run.health.wheel_fault)
        assert base.await_stand(1.0)
        assert base.fastest_since(0.0) < 0.4


def test_released_emergency_stop_does_not_start_the_base(base: VirtualBase) -> None:
    with LoopRun(base) as run:
        run.drive()
        base.device.controller.emergency_stop = True
        run.await_that(lambda: run.health.status.errors == ("emergency stop",))
        assert base.await_stand(1.0)
        base.device.controller.emergency_stop = False
        run.await_that(lambda: not run.health.status.errors)
        assert_waits_for_rest(run)


def test_high_current_while_stopping_is_a_named_warning(base: VirtualBase) -> None:
    with LoopRun(base, stall_s=5.0) as run:
        run.drive()
        base.device.controller.set_fault(2, "overcurrent")
        run.await_that(lambda: run.health.status.warnings == ("over-current of M2",))

        run.await_that(lambda: run.health.currents[1] < -10.0)


def test_controller_that_lost_power_is_set_up_again(base: VirtualBase) -> None:
    with LoopRun(base) as run:
        run.drive()
        base.device.controller.power_cycle()
        run.await_that(lambda: len(run.ready) == 2)

        assert not run.ready[1].kept_power
        assert "switched off and on" in str(run.device_errors[0])
        assert base.device.controller.timeout_s == 1.0
        assert 0.0 < distance(run) < 2.0, "the counters' jump was counted as distance"
        assert_waits_for_rest(run)


def test_power_loss_is_detected_by_the_counters_if_settings_were_saved(
    base: VirtualBase,
) -> None:
    with LoopRun(base) as run:
        run.drive(0.5)
        run.await_that(lambda: distance(run) > 0.1)
        before = distance(run)
        base.unplug()
        assert base.await_stand(3.0)
        base.device.controller.power_cycle()
        base.device.controller.timeout_s = 1.0  # as saved
        base.plug_in()
        run.await_that(lambda: len(run.ready) == 2)

        assert run.ready[1].kept_power
        assert distance(run) >= before, "the reset of the counters was counted as distance"
        assert_waits_for_rest(run)


def assert_waits_for_rest(run: LoopRun) -> None:
    """Check that the base stays at rest until it was commanded to rest once."""
    count = len(run.steps)
    run.await_that(lambda: len(run.steps) > count + 20)
    assert not run.base.turns()
    assert run.health.awaits_rest

    run.command(0.0)
    run.await_that(lambda: not run.health.awaits_rest)
    run.drive()
    assert run.health.wheel_fault is None


def test_wheels_that_slow_down_after_a_delay_do_not_count_as_runaways(base: VirtualBase) -> None:
    with LoopRun(base, acceleration=0.8, turn_acceleration=0.5, speed=0.8) as run:
        run.drive(0.8)
        run.hold_up(0.6)  # too short for the controller to stop the wheels
        run.await_that(lambda: run.held_up)
        assert base.device.timeouts == 0
        run.command(0.0)

        assert base.await_stand(3.0)
        assert run.health.wheel_fault is None


def test_distance_while_unplugged_is_found_in_the_counters(base: VirtualBase) -> None:
    with LoopRun(base) as run:
        run.drive(0.5)
        base.unplug()
        assert base.await_stand(3.0), "the serial timeout did not stop the wheels"
        base.plug_in()
        run.await_that(lambda: len(run.ready) == 2)
        run.command(0.0)
        run.await_that(
            lambda: not base.turns() and abs(distance(run) - base.true_pose()[0]) < 0.002
        )

        assert base.device.timeouts >= 1
        assert run.ready[1].kept_power
        assert distance(run) > 0.05


def test_distance_while_stopping_is_not_lost(base: VirtualBase) -> None:
    with LoopRun(base, acceleration=1.0) as run:
        run.drive(0.5)
        run.stop()
        assert distance(run) < base.true_pose()[0] - 0.01  # the wheels went on after the last step
        run.command(0.0)
        run.restart()

        run.await_that(lambda: abs(distance(run) - base.true_pose()[0]) < 0.002)


def distance(run: LoopRun) -> float:
    return sum(step.distance for step in run.steps)


@pytest.mark.parametrize(
    ("parameters", "loops", "message"),
    [
        ({"speed": 3.0}, (1, 1, 1, 30_000), "reach 2.24 m/s .* less than speed = 3 m/s"),
        ({}, (0, 0, 0, 30_000), "the speed loop of M1 is not tuned"),
        ({}, (1, 1, 1, 0), "the speed loop of M1 is not tuned"),
    ],
)
def test_unusable_controller_is_rejected(
    base: VirtualBase,
    parameters: dict[str, object],
    loops: tuple[int, int, int, int],
    message: str,
) -> None:
    base.device.controller.loops[0] = loops
    config = RoboclawBaseConfig.model_validate({**PARAMETERS, "port": "/dev/none", **parameters})
    loop = DriveLoop(
        config.drive_settings(),
        base.open,
        LatestCommand(0.3),
        ControllerHealth(),
        on_ready=lambda _: None,
        on_step=lambda _: None,
    )

    with pytest.raises(UnusableControllerError, match=message):
        loop.check_device()


def test_battery_limits_are_set_and_effective(base: VirtualBase) -> None:
    with LoopRun(base, battery_min_v=11.0, battery_max_v=16.8) as run:
        run.drive()
        assert base.device.controller.main_limits == (11.0, 16.8)
        base.device.controller.voltage = 10.5
        run.await_that(lambda: run.health.status.errors == ("main battery voltage low",))

        assert base.await_stand(1.0)
        run.await_that(lambda: run.health.voltage == 10.5)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"battery_min_v": 10.0}, "set both or neither"),
        ({"battery_min_v": 17.0, "battery_max_v": 16.0}, "not below"),
        ({"device_timeout_s": 0.1, "rate": 20}, "less than 4 periods"),
        ({"device_timeout_s": 0.25}, "multiple of 0.1"),
        ({"speed": float("nan")}, "finite"),
    ],
)
def test_inconsistent_parameters_are_rejected(parameters: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        RoboclawBaseConfig.model_validate({**PARAMETERS, **parameters})


def test_missing_port_is_named() -> None:
    with pytest.raises(LinkLost, match=words_in_order("/dev/no-roboclaw", "No such file")):
        open_line("/dev/no-roboclaw", 115200)
    with pytest.raises(LinkLost, match=words_in_order("tcp:somewhere", "port", "write")):
        open_line("tcp:somewhere", 115200)

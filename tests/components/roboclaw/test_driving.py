"""The conversation that drives, with an emulated controller: what stops the wheels, and why."""

import logging
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from cairn.components.roboclaw.commanding import LatestCommand
from cairn.components.roboclaw.config import RoboclawBaseConfig
from cairn.components.roboclaw.driving import Driving, Step
from cairn.components.roboclaw.health import Health
from cairn.components.roboclaw.lines import open_line
from cairn.components.roboclaw.setting_up import NotUsable, Ready
from cairn.driver.device_thread import DeviceThread
from cairn.driver.errors import DeviceError, LinkLost
from tests.components.roboclaw.emulated_base import PARAMETERS, EmulatedBase, emulated_base


class Driven:
    """A conversation on a thread of its own, commanded again and again."""

    def __init__(self, base: EmulatedBase, **parameters: object) -> None:
        given = {
            "acceleration": 4.0,
            "turn_acceleration": 20.0,
            "stall_s": 0.4,
            "device_timeout_s": 1.0,
            **parameters,
        }
        config = RoboclawBaseConfig.model_validate({**PARAMETERS, "port": str(base.path), **given})
        self.base = base
        self.health = Health()
        self.steps: list[Step] = []
        self.trouble: list[DeviceError] = []
        self.failures: list[Exception] = []
        self.ready: list[Ready] = []
        self._command = LatestCommand(config.command_timeout_s)
        self._wanted = (0.0, 0.0)
        self._over = threading.Event()
        self._commander = threading.Thread(target=self._give, daemon=True)
        self._driving = Driving(
            config.drive_settings(),
            lambda: open_line(config.port, config.baud),
            self._command,
            self.health,
            on_ready=self.ready.append,
            on_step=self._note,
        )
        self._thread = self._new_thread()
        self._hold_up_s = 0.0
        self.held_up = False

    def hold_up(self, seconds: float) -> None:
        """Have the conversation make a pause, as on a computer that is busy."""
        self.held_up, self._hold_up_s = False, seconds

    def command(self, forward: float, turn: float = 0.0) -> None:
        self._wanted = (forward, turn)

    def drive(self, forward: float = 0.3) -> None:
        """Have it go, and wait until it does."""
        self.command(forward)
        assert self.base.await_that(lambda: self.base.speed() > 0.7 * abs(forward))

    def await_that(self, holds: Callable[[], bool]) -> None:
        assert self.base.await_that(holds), f"{self.health}, {self.trouble}, {self.failures}"

    def stop(self) -> None:
        self._thread.stop()

    def start_again(self) -> None:
        self._thread = self._new_thread()
        self._thread.start()

    def _new_thread(self) -> DeviceThread:
        return DeviceThread(
            "driven",
            self._driving.converse,
            log=logging.getLogger("driven"),
            on_device_error=self.trouble.append,
            on_failure=self.failures.append,
        )

    def _note(self, step: Step) -> None:
        self.steps.append(step)
        if self._hold_up_s:
            time.sleep(self._hold_up_s)
            self.held_up, self._hold_up_s = True, 0.0

    def _give(self) -> None:
        while not self._over.wait(0.02):
            self._command.give(time.monotonic(), *self._wanted)

    def __enter__(self) -> "Driven":
        self._thread.start()
        self._commander.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._thread.stop()
        self._over.set()
        self._commander.join()


@pytest.fixture
def base(tmp_path: Path) -> Iterator[EmulatedBase]:
    with emulated_base(tmp_path) as base:
        yield base


def test_told_to_end_it_leaves_wheels_that_stand(base: EmulatedBase) -> None:
    with Driven(base) as driven:
        driven.drive()
        driven.stop()

        assert not base.turns()
        assert base.device.timeouts == 0  # it was the driver who stopped them


def test_a_wheel_that_is_held_has_the_motors_switched_off(base: EmulatedBase) -> None:
    with Driven(base) as driven:
        driven.drive()
        base.device.controller.set_fault(1, "stalled")
        driven.await_that(lambda: driven.health.fault is not None)

        assert "left wheel" in str(driven.health.fault)
        assert base.await_stand(1.0)
        base.device.controller.set_fault(1, None)
        count = len(driven.steps)
        driven.await_that(lambda: len(driven.steps) > count + 20)
        assert not base.turns(), "it set off again by itself"


def test_an_encoder_that_counts_backwards_is_found_before_the_wheel_is_fast(
    base: EmulatedBase,
) -> None:
    base.device.controller.set_fault(2, "encoder_reversed")
    with Driven(base) as driven:
        driven.command(0.2)
        driven.await_that(lambda: driven.health.fault is not None)

        assert "it counts against its motor" in str(driven.health.fault)
        assert base.await_stand(1.0)
        assert base.fastest_since(0.0) < 0.4


def test_an_encoder_without_its_cable_does_not_make_the_wheel_run_away(
    base: EmulatedBase,
) -> None:
    with Driven(base) as driven:
        driven.drive(0.2)
        base.device.controller.set_fault(1, "encoder_off")
        driven.await_that(lambda: driven.health.fault is not None)

        assert "stands still" in str(driven.health.fault)
        assert base.await_stand(1.0)
        assert base.fastest_since(0.0) < 0.4


def test_an_emergency_stop_that_is_released_does_not_set_the_base_off(base: EmulatedBase) -> None:
    with Driven(base) as driven:
        driven.drive()
        base.device.controller.emergency_stop = True
        driven.await_that(lambda: driven.health.status.errors == ("emergency stop",))
        assert base.await_stand(1.0)
        base.device.controller.emergency_stop = False
        driven.await_that(lambda: not driven.health.status.errors)
        sees_that_it_does_not_set_off_by_itself(driven)


def test_over_current_is_a_warning_by_name(base: EmulatedBase) -> None:
    with Driven(base, stall_s=5.0) as driven:
        driven.drive()
        base.device.controller.set_fault(2, "overcurrent")
        driven.await_that(lambda: driven.health.status.warnings == ("over-current of M2",))

        driven.await_that(lambda: driven.health.currents[1] < -10.0)


def test_a_controller_that_lost_power_is_set_up_anew(base: EmulatedBase) -> None:
    with Driven(base) as driven:
        driven.drive()
        base.emulator.call(base.device.controller.power_cycle)
        driven.await_that(lambda: len(driven.ready) == 2)

        assert not driven.ready[1].kept_power
        assert "switched off and on" in str(driven.trouble[0])
        assert base.device.controller.timeout_s == 1.0
        assert 0.0 < way(driven) < 2.0, "the counters' jump was taken for a way"
        sees_that_it_does_not_set_off_by_itself(driven)


def test_one_that_lost_power_is_known_by_its_counters_if_its_settings_were_saved(
    base: EmulatedBase,
) -> None:
    with Driven(base) as driven:
        driven.drive(0.5)
        driven.await_that(lambda: way(driven) > 0.1)
        before = way(driven)
        base.unplug()
        assert base.await_stand(3.0)
        base.emulator.call(base.device.controller.power_cycle)
        base.device.controller.timeout_s = 1.0  # as saved
        base.plug_in()
        driven.await_that(lambda: len(driven.ready) == 2)

        assert driven.ready[1].kept_power
        assert way(driven) >= before, "that the counters began anew was taken for a way back"
        sees_that_it_does_not_set_off_by_itself(driven)


def sees_that_it_does_not_set_off_by_itself(driven: Driven) -> None:
    """An emergency stop may have taken its power; once commanded to rest, it may go."""
    count = len(driven.steps)
    driven.await_that(lambda: len(driven.steps) > count + 20)
    assert not driven.base.turns()
    assert driven.health.awaits_rest

    driven.command(0.0)
    driven.await_that(lambda: not driven.health.awaits_rest)
    driven.drive()
    assert driven.health.fault is None


def test_wheels_that_slow_down_after_it_was_held_up_do_not_run_away(base: EmulatedBase) -> None:
    with Driven(base, acceleration=0.8, turn_acceleration=0.5, speed=0.8) as driven:
        driven.drive(0.8)
        driven.hold_up(0.6)  # not for so long that the controller stops the wheels
        driven.await_that(lambda: driven.held_up)
        assert base.device.timeouts == 0
        driven.command(0.0)

        assert base.await_stand(3.0)
        assert driven.health.fault is None


def test_over_an_unplugging_the_way_goes_on_with_the_counters(base: EmulatedBase) -> None:
    with Driven(base) as driven:
        driven.drive(0.5)
        base.unplug()
        assert base.await_stand(3.0), "the serial timeout did not stop the wheels"
        base.plug_in()
        driven.await_that(lambda: len(driven.ready) == 2)
        driven.command(0.0)
        driven.await_that(
            lambda: not base.turns() and abs(way(driven) - base.true_pose()[0]) < 0.002
        )

        assert base.device.timeouts >= 1
        assert driven.ready[1].kept_power
        assert way(driven) > 0.05


def test_the_way_of_stopping_is_not_lost(base: EmulatedBase) -> None:
    with Driven(base, acceleration=1.0) as driven:
        driven.drive(0.5)
        driven.stop()
        assert way(driven) < base.true_pose()[0] - 0.01  # it went on while nobody was told
        driven.command(0.0)
        driven.start_again()

        driven.await_that(lambda: abs(way(driven) - base.true_pose()[0]) < 0.002)


def way(driven: Driven) -> float:
    return sum(step.way for step in driven.steps)


@pytest.mark.parametrize(
    ("parameters", "loops", "refusal"),
    [
        ({"speed": 3.0}, (1, 1, 1, 30_000), "reach 2.24 m/s .* less than speed = 3 m/s"),
        ({}, (0, 0, 0, 30_000), "the speed loop of M1 is not tuned"),
        ({}, (1, 1, 1, 0), "the speed loop of M1 is not tuned"),
    ],
)
def test_what_cannot_be_driven_is_refused(
    base: EmulatedBase,
    parameters: dict[str, object],
    loops: tuple[int, int, int, int],
    refusal: str,
) -> None:
    base.device.controller.loops[0] = loops
    config = RoboclawBaseConfig.model_validate({**PARAMETERS, "port": str(base.path), **parameters})
    driving = Driving(
        config.drive_settings(),
        lambda: open_line(config.port, config.baud),
        LatestCommand(0.3),
        Health(),
        on_ready=lambda _: None,
        on_step=lambda _: None,
    )

    with pytest.raises(NotUsable, match=refusal):
        driving.look()


def test_the_battery_limits_are_set_and_obeyed(base: EmulatedBase) -> None:
    with Driven(base, battery_min_v=11.0, battery_max_v=16.8) as driven:
        driven.drive()
        assert base.device.controller.main_limits == (11.0, 16.8)
        base.device.controller.voltage = 10.5
        driven.await_that(lambda: driven.health.status.errors == ("main battery voltage low",))

        assert base.await_stand(1.0)
        driven.await_that(lambda: driven.health.voltage == 10.5)


@pytest.mark.parametrize(
    ("parameters", "refusal"),
    [
        ({"battery_min_v": 10.0}, "give both or neither"),
        ({"battery_min_v": 17.0, "battery_max_v": 16.0}, "not below"),
        ({"device_timeout_s": 0.1, "rate": 20}, "less than 4 periods"),
        ({"device_timeout_s": 0.25}, "multiple of 0.1"),
        ({"speed": float("nan")}, "finite"),
    ],
)
def test_parameters_that_make_no_sense_are_refused(
    parameters: dict[str, object], refusal: str
) -> None:
    with pytest.raises(ValueError, match=refusal):
        RoboclawBaseConfig.model_validate({**PARAMETERS, **parameters})


def test_a_port_that_is_not_there_is_named() -> None:
    with pytest.raises(LinkLost, match="/dev/no-roboclaw cannot be opened: No such file"):
        open_line("/dev/no-roboclaw", 115200)
    with pytest.raises(LinkLost, match="tcp:somewhere names no TCP port; write it as"):
        open_line("tcp:somewhere", 115200)

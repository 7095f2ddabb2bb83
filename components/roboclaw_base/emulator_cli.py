"""`cairn emulate roboclaw`: an emulated motor controller with two motors."""

from __future__ import annotations

from typing import Annotated, get_args

import typer

from cairn import CairnError
from cairn.components.roboclaw_base.emulator import EmulatedRoboclaw
from cairn.components.roboclaw_base.emulator_controller import Firmware, MotorFault
from cairn.components.roboclaw_base.protocol import ADDRESSES
from cairn.driver.emulator_cli import (
    FaultCommand,
    Faults,
    LineOptions,
    Paced,
    Pty,
    Seed,
    Serial,
    Tcp,
    emulate,
)

_FIRMWARES: tuple[Firmware, ...] = get_args(Firmware)
_FAULTS: tuple[MotorFault, ...] = get_args(MotorFault)


def roboclaw(
    pty: Pty = None,
    tcp: Tcp = None,
    serial: Serial = None,
    version: Annotated[
        str, typer.Option(help="Product and firmware that it reports.")
    ] = "USB Roboclaw 2x7a v4.2.8",
    address: Annotated[
        int | None,
        typer.Option(
            min=ADDRESSES[0], max=ADDRESSES[-1], help="Its address; default: all, as over USB."
        ),
    ] = None,
    baud: Annotated[
        int | None, typer.Option(help="Speed of its line [bit/s]; default: any, as over USB.")
    ] = None,
    full_speed: Annotated[
        float, typer.Option(min=1.0, metavar="QPPS", help="Full speed of both motors [counts/s].")
    ] = 12_000.0,
    lag: Annotated[
        float, typer.Option(min=0.001, max=5.0, help="Time constant of the motors [s].")
    ] = 0.05,
    first_count: Annotated[
        int, typer.Option(min=0, max=0xFFFFFFFF, help="Counters of both encoders at power-on.")
    ] = 0,
    firmware: Annotated[
        str,
        typer.Option(
            help=f"Generation of its firmware, as replies differ: {', '.join(_FIRMWARES)}."
        ),
    ] = "usual",
    faults: Faults = "",
    seed: Seed = 0,
    paced: Paced = False,
) -> None:
    """Emulate a Basicmicro RoboClaw with two motors and their encoders.

    For example: cairn emulate roboclaw --pty /tmp/base

    Emulated are also a battery, the serial timeout, the packet timeout (10 ms), checksums and
    32-bit counters; not buffered commands. Unplugging interrupts the line, not the motors.
    """
    device = EmulatedRoboclaw(
        version=version,
        address=address,
        baud=baud,
        full_speed=full_speed,
        lag_s=lag,
        first_counts=(first_count, first_count),
        firmware=_firmware(firmware),
    )
    emulate(
        version,
        device,
        LineOptions(pty, tcp, serial),
        faults=faults,
        seed=seed,
        paced=paced,
        commands=_commands(device),
    )


def _firmware(name: str) -> Firmware:
    for known in _FIRMWARES:
        if known == name:
            return known
    raise CairnError(f"--firmware {name}: unknown generation; use one of {', '.join(_FIRMWARES)}")


def _commands(device: EmulatedRoboclaw) -> dict[str, FaultCommand]:
    controller = device.controller

    def motor(words: list[str]) -> str:
        number, fault = words if len(words) == 2 else ("", "")
        if number not in ("1", "2") or fault not in ("ok", *_FAULTS):
            raise CairnError(f"write motor 1|2 ok|{'|'.join(_FAULTS)}")
        known = next((name for name in _FAULTS if name == fault), None)
        controller.set_fault(int(number), known)
        return f"motor {number}: {fault}"

    def stop(words: list[str]) -> str:
        if words not in (["on"], ["off"]):
            raise CairnError("write stop on, or stop off")
        controller.emergency_stop = words == ["on"]
        return f"emergency stop {words[0]}"

    def battery(words: list[str]) -> str:
        try:
            (text,) = words
            controller.voltage = float(text)
        except ValueError as error:
            raise CairnError("write battery VOLTS") from error
        return f"main battery {controller.voltage:g} V"

    def power(words: list[str]) -> str:
        if words:
            raise CairnError("write power alone")
        controller.power_cycle()
        return "switched off and on"

    def wheels(words: list[str]) -> str:
        if words:
            raise CairnError("write wheels alone")
        motors = (
            f"{motor.speed:.0f} counts/s, {motor.turned:.0f} counts" for motor in controller.motors
        )
        return f"{'; '.join(motors)}; stopped by the serial timeout {device.timeouts} times"

    return {
        "motor": FaultCommand(f"1|2 ok|{'|'.join(_FAULTS)}", "set the fault of a motor", motor),
        "stop": FaultCommand("on|off", "press the emergency stop, or release it", stop),
        "battery": FaultCommand("VOLTS", "set the voltage of the main battery", battery),
        "power": FaultCommand("", "lose power for a moment, and all settings", power),
        "wheels": FaultCommand("", "print how both motors truly turn", wheels),
    }

"""A differential base on a Basicmicro RoboClaw motor controller: driver, emulator, probe."""

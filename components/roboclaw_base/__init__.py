"""Driver, emulator and probe of a differential base on a Basicmicro RoboClaw motor controller."""

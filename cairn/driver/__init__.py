"""What drivers share: device threads, lines to devices, clocks, diagnostics, and the emulator.

- `device_thread`: the thread that talks with a device; reopens a device that failed or was
  unplugged; drops the oldest measurement if the component is busy
- `errors`: `DeviceError`, `LinkLost`
- `serial_and_tcp`: serial ports and TCP connections: opening, reading, writing
- `usb_ports`: finds a serial port by USB numbers
- `command_timeout`: the newest velocity command, until it is stale
- `device_names`: which parameters name a device, for `cairn doctor`
- `device_clock`: converts a device's own time to system time
- `diagnostics`: the message on topic `diagnostics`; measured rates
- `emulator`: runs an emulated device on a line; injects faults
- `emulator_lines`: where an emulator is connected: pseudo-terminal, TCP port, real serial port
- `emulator_cli`: `cairn emulate`: options, fault commands on stdin, recordings
"""

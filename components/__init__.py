"""The components of Cairn: drivers of hardware, simulation, replay, and the navigation system.

Drivers have the same files, as far as they need them:

- `component.py`: the component: ports, life cycle, what is published
- `config.py`: its parameters
- `protocol.py`: the device's protocol as pure functions, bytes in and values out; detects damage
- `client.py`: requests and replies over a line
- `sensor.py` (`base.py`, `camera.py`): the connected device, and the loop on the device thread
- `messages.py`: values of the protocol as messages
- `stamping.py` (`frames.py`): when something was measured
- `health.py`: what diagnostics report
- `emulator.py`, `emulator_*.py`: the emulated device
- `emulator_cli.py`: `cairn emulate NAME`
- `probe_cli.py`: `cairn driver probe NAME`

What they share is in `cairn.driver`: the device thread, which opens a failed or unplugged device
again and drops measurements that the component has no time for, lines, clocks, diagnostics, and
the emulator.
"""

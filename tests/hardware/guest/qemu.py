"""Control over the guest's own machine: plugs USB devices in and unplugs them.

QEMU Machine Protocol, docs/interop/qmp-spec.txt of QEMU: one JSON object per line.
"""

import json
from pathlib import Path
from typing import Any

_PORT = Path("/dev/virtio-ports/control")


def add_device(driver: str, name: str, **properties: str) -> None:
    """Plug a device in; returns when QEMU has done so."""
    _execute("device_add", driver=driver, id=name, **properties)


def remove_device(name: str) -> None:
    """Pull a device out; returns when QEMU has done so."""
    _execute("device_del", id=name)


def _execute(command: str, **arguments: str) -> None:
    with _PORT.open("r+b", buffering=0) as port:
        # The first command of a connection; repetitions are refused, which does no harm.
        _answer(port, {"execute": "qmp_capabilities"})
        answer = _answer(port, {"execute": command, "arguments": arguments})
    assert "return" in answer, f"QEMU refuses {command} {arguments}: {answer}"


def _answer(port: Any, message: dict[str, Any]) -> dict[str, Any]:
    port.write(json.dumps(message).encode() + b"\n")
    while True:  # a greeting and events may precede the reply
        answer: dict[str, Any] = json.loads(_line(port))
        if "return" in answer or "error" in answer:
            return answer


def _line(port: Any) -> bytes:
    line = b""
    while not line.endswith(b"\n"):
        line += port.read(1)
    return line

"""Whether Cairn's udev rules are installed."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from cairn.cli.doctor.finding import Finding
from cairn.deployment.shipped import FOLDER

_TOPIC = "computer"
_NAME = "70-cairn.rules"
_FOLDERS = (
    "etc/udev/rules.d",
    "run/udev/rules.d",
    "usr/local/lib/udev/rules.d",
    "usr/lib/udev/rules.d",
)


def rules(root: Path = Path("/")) -> Iterator[Finding]:
    """One finding: where the rules are, or how to install them."""
    places = [root / folder / _NAME for folder in _FOLDERS]
    found = next((str(place) for place in places if place.exists()), "")
    if found:
        yield Finding(_TOPIC, "udev rules", "ok", found)
        return
    remedy = (
        f"sudo cp {FOLDER}/robot/{_NAME} /etc/udev/rules.d/ && sudo udevadm control --reload && "
        "sudo udevadm trigger"
    )
    what = "not installed: a robot's devices have no stable names and rights without them"
    yield Finding(_TOPIC, "udev rules", "warn", what, remedy)

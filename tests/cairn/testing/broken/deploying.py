"""One deployment with many drivers, and a class of tests for each of them."""

import json
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

from cairn import Component
from cairn.runtime.ports import ports_of
from cairn.testing.robot import Bench

ROOT = Path(__file__).parents[4]


def name_of(driver: type[Component]) -> str:
    """The driver's name in the deployment."""
    return driver.__name__.lower()


def bench_of(
    folder: Path,
    drivers: Sequence[type[Component]],
    alone: Collection[type[Component]],
    hanging: Collection[type[Component]],
) -> Bench:
    """All drivers in one deployment, those `alone` in processes of their own.

    The topics of each are below its name, and the device of a driver that has one is a file. Those
    `hanging` when they are stopped are killed soon.
    """
    components: dict[str, Any] = {}
    commanded = []
    for driver in drivers:
        name = name_of(driver)
        topics = {port: f"{name}/{port}" for port in ports_of(driver)}
        if "cmd_vel" in topics:
            commanded.append(topics["cmd_vel"])
        device = {"device": str(folder / name)} if "scan" in topics else {}
        components[name] = {
            "plugin": f"{driver.__module__}:{driver.__name__}",
            "placement": "process" if driver in alone else "in_process",
            "parameters": device,
            "topics": topics,
            "stop_timeout_s": 0.5 if driver in hanging else 5.0,
        }
    document = {
        "components": components,
        "supervision": {"max_restarts": 1000, "within_s": 1},
        "external_topics": commanded,
    }
    text = "\n".join(f"{key}: {json.dumps(value)}" for key, value in document.items())
    return Bench(folder, text, environment={"PYTHONPATH": str(ROOT)})


def contracts(
    contract: type, drivers: Sequence[type[Component]], **settings: Any
) -> dict[str, type]:
    """The classes of tests by name: the contract, for each of the drivers."""
    return {
        f"Test{driver.__name__}": type(
            f"Test{driver.__name__}", (contract,), {"component": name_of(driver), **settings}
        )
        for driver in drivers
    }

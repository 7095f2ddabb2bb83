"""What all tests may use: the project's own conformance kit, as users have it."""

import gc
import os
import signal
import sys

import pytest
from hypothesis import settings

pytest_plugins = ["cairn.testing.plugin", "cairn_lab.testing"]


def pytest_configure() -> None:
    """Prepare this process, and the environment of the programs that tests start."""
    # What is imported and collected lives until the end: the garbage collector need not search it.
    gc.disable()
    # With PYTHONDONTWRITEBYTECODE each of hundreds of processes would compile all modules again,
    # and each run of the tests all test files: most of the time that it takes to collect them.
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    sys.dont_write_bytecode = False
    # A shell that runs a command in the background has it ignore SIGINT, and nohup SIGHUP; so would
    # all programs that it starts.
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    # Threads of NumPy and OpenCV in several workers would wait for each other's cores.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ.setdefault("OPENCV_FOR_THREADS_NUM", "1")
    # A busy machine makes no example wrong; half the default number finds as much, and the whole
    # suite is run often.
    settings.register_profile("cairn", deadline=None, max_examples=50)
    settings.load_profile("cairn")


_REAL = {"launch", "deploy", "bench", "network"}
"""Fixtures that start real processes, or open real Zenoh sessions."""

_LONG = ("processes", "images", "slow")
"""Marks of tests that may take seconds."""


@pytest.hookimpl(tryfirst=True)  # also in the process that only distributes the tests
def pytest_runtestloop() -> None:
    """Leave what was collected out of all later garbage collections."""
    gc.freeze()
    gc.enable()


@pytest.hookimpl(tryfirst=True)  # before the plugins that read marks and groups
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark the tests that use real processes, and group the tests of a file for parallel runs.

    The tests of a file share what they launch, so one worker runs all tests of a file. Those of a
    group of their own, such as robots that drive in real time, never run side by side, and run
    first: such a group takes long, and at the end all other workers would wait for it. Files whose
    tests are quick run last, so that no worker begins a long one at the end.
    """
    for item in items:
        if isinstance(item, pytest.Function) and _REAL.intersection(item.fixturenames):
            item.add_marker(pytest.mark.processes)
    if not hasattr(config, "workerinput"):  # in one process: in the order of the command line
        return
    long = {item.path for item in items if any(map(item.get_closest_marker, _LONG))}
    items.sort(
        key=lambda item: (item.get_closest_marker("xdist_group") is None, item.path not in long)
    )
    for item in items:
        if item.get_closest_marker("xdist_group") is None:
            item.add_marker(pytest.mark.xdist_group(item.nodeid.partition("::")[0]))

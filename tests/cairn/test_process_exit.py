"""How a process ends while its threads are at work."""

import subprocess
import sys

import pytest

from tests.patience import LIMIT_S

pytestmark = pytest.mark.processes


# A thread is within Zenoh, and messages come to it: Python's own end aborts the process here.
_BUSY = """
import atexit, sys, threading
import zenoh
from cairn.bus.session import open_router
from cairn.process_exit import end_process
from cairn.testing.launching import free_port

session = open_router(f"tcp/127.0.0.1:{free_port()}")
publisher = session.declare_publisher("busy")
received = threading.Event()
subscriber = session.declare_subscriber("busy", zenoh.handlers.RingChannel(3))

def receive():
    while True:
        subscriber.handler.recv()
        received.set()

def send():
    while True:
        publisher.put(b"x")

for work in (receive, send):
    threading.Thread(target=work, daemon=True).start()
assert received.wait(20)
atexit.register(lambda: print("what was to be done at the end"))
print("said before", end=" ")
end_process(3)
"""


def test_threads_within_zenoh_do_not_turn_the_exit_code_into_an_abort() -> None:
    ended = subprocess.run(
        [sys.executable, "-c", _BUSY], capture_output=True, text=True, timeout=LIMIT_S, check=False
    )

    assert (ended.returncode, ended.stderr) == (3, "")
    assert ended.stdout == "said before what was to be done at the end\n"

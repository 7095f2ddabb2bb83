"""A process on the bus for the tests: `peer.py ENDPOINT NAME SECRET`.

It waits for its peers, publishes one word on /robot/word, and prints "ready" with the peers that it
did not reach. Then it publishes one word per line of its standard input, and prints "received WORD"
for each word on /robot/answer. Its links outlast any time for which a test stops it.
"""

import sys
import threading

from cairn import RELIABLE
from cairn.bus import session
from cairn.bus.zenoh_bus import ZenohBus
from cairn.schemas.std_msgs import String

LIMIT_S = 120.0


def main(endpoint: str, name: str, secret: str) -> None:
    session.LEASE_MS = 3_600_000
    bus = ZenohBus(session.open_peer([endpoint], secret=secret), secret=secret)
    node = bus.node(f"/robot/{name}", print_line)
    arrived = threading.Semaphore(0)
    answers = node.subscribe("/robot/answer", String, RELIABLE, arrived.release)
    words = node.advertise("/robot/word", String, RELIABLE)

    def receive() -> None:
        while arrived.acquire():
            answer = answers.take()
            print_line(f"received {answer.data if answer is not None else answer}")

    threading.Thread(target=receive, daemon=True).start()
    unreached = bus.wait_for_peers(LIMIT_S)
    words.publish(String(data=f"first of {name}"))
    print_line(f"ready {unreached}")
    for line in sys.stdin:
        words.publish(String(data=line.strip()))
    bus.close()


def print_line(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main(*sys.argv[1:])

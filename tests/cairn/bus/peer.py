"""A process on the bus for the tests: `peer.py ENDPOINT NAME`; obeys lines on its input.

It says one word on /robot/word as soon as it has settled, then "settled" on its output; then for
each line one more word, and for each word on /robot/answer a line "heard WORD".
"""

import sys
import threading

from cairn import RELIABLE
from cairn.bus.session import open_peer
from cairn.bus.zenoh_bus import ZenohBus
from cairn.schemas.std_msgs import String


def main(endpoint: str, name: str) -> None:
    bus = ZenohBus(open_peer([endpoint]))
    node = bus.node(f"/robot/{name}", tell)
    arrived = threading.Semaphore(0)
    answers = node.subscribe("/robot/answer", String, RELIABLE, arrived.release)
    words = node.advertise("/robot/word", String, RELIABLE)

    def listen() -> None:
        while arrived.acquire():
            answer = answers.take()
            tell(f"heard {answer.data if answer is not None else answer}")

    threading.Thread(target=listen, daemon=True).start()
    unreached = bus.wait_for_peers(10.0)
    words.publish(String(data=f"first of {name}"))
    tell(f"settled {unreached}")
    for line in sys.stdin:
        words.publish(String(data=line.strip()))
    bus.close()


def tell(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main(*sys.argv[1:])

"""A bell that wakes a waiting thread."""

import threading


class Bell:
    """Wakes the one thread that waits for it; several rings before it waits count as one.

    Any thread may ring it, and a signal handler at any moment, which an Event does not allow.
    `queue.SimpleQueue` would do the same, but up to Python 3.12 its `get(timeout=...)` can wait
    forever: after the first attempt it computes the time that is left, and takes a negative one,
    which a busy computer easily causes, for no limit.
    """

    def __init__(self) -> None:
        self._silent = threading.Lock()  # free while a ring has not been heard
        self._silent.acquire()

    def ring(self) -> None:
        """Wake the waiting thread, or have its next wait end at once."""
        try:
            self._silent.release()
        except RuntimeError:  # it has been rung already
            return

    def wait(self, timeout_s: float) -> bool:
        """Wait for a ring, at most so long [s, not negative]; return whether there was one."""
        return self._silent.acquire(timeout=timeout_s)

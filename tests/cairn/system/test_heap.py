"""The heap of a process: one for all threads, and free memory returns to the system."""

import os
import subprocess
import sys
from pathlib import Path

from cairn.system.heap import SMALL_THREAD_CACHES, TUNABLES

_THREADS = """
import ctypes, sys, threading
from cairn.system.heap import share_heap
share_heap()
allocated, go = threading.Barrier(9), threading.Event()
def allocate():
    kept = [bytearray(5000) for _ in range(20)]
    allocated.wait()
    go.wait()
for _ in range(8):
    threading.Thread(target=allocate, daemon=True).start()
allocated.wait()
libc = ctypes.CDLL(None)
libc.fopen.restype = ctypes.c_void_p
file = ctypes.c_void_p(libc.fopen(sys.argv[1].encode(), b"w"))
libc.malloc_info(0, file)
libc.fclose(file)
go.set()
"""

_BURST = """
import os, resource
from pathlib import Path
from cairn.system.heap import return_free_memory
def memory():
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 2**20
before = memory()
burst = [bytearray(100_000) for _ in range(400)]
last = bytearray(100_000)  # holds the end of the heap
del burst
kept = memory()
return_free_memory()
print(kept - before, memory() - before)
"""


_AGAIN = """
import os, sys
from cairn.system.heap import restart_with_small_thread_caches
print(os.getpid(), flush=True)
restart_with_small_thread_caches()
print(os.getpid(), sys.argv[1], os.environ.get("GLIBC_TUNABLES", ""))
"""


def _run(code: str, *arguments: str, **environment: str) -> str:
    inherited = {
        name: value
        for name, value in os.environ.items()
        if "MALLOC" not in name and name != TUNABLES
    }
    return subprocess.run(
        [sys.executable, "-c", code, *arguments],
        env=inherited | environment,
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    ).stdout


def _heaps(folder: Path, **environment: str) -> int:
    file = folder / "malloc.xml"
    _run(_THREADS, str(file), **environment)
    return file.read_text(encoding="utf-8").count("<heap nr=")


def test_all_threads_use_one_heap_unless_the_environment_sets_another_number(
    tmp_path: Path,
) -> None:
    assert _heaps(tmp_path) == 1
    assert _heaps(tmp_path, MALLOC_ARENA_MAX="4") == 4


def test_program_begins_again_with_small_caches_unless_the_environment_sets_tunables() -> None:
    before, begun_again, *after = _run(_AGAIN, "as typed").splitlines()
    assert begun_again == before
    assert after == [f"{before} as typed {SMALL_THREAD_CACHES}"]

    # A privileged program loses its tunables in between.
    before, *after = _run(_AGAIN, "x", CAIRN_RESTARTED_WITH_TUNABLES="1").splitlines()
    assert after == [f"{before} x "]

    before, *after = _run(_AGAIN, "x", GLIBC_TUNABLES="glibc.malloc.tcache_count=7").splitlines()
    assert after == [f"{before} x glibc.malloc.tcache_count=7"]


def test_memory_of_a_burst_returns_to_the_system() -> None:
    # As in the process of a component, which keeps freed memory for the next image.
    kept_mib, left_mib = map(float, _run(_BURST, MALLOC_MMAP_THRESHOLD_=str(32 << 20)).split())

    assert kept_mib > 35
    assert left_mib < 5

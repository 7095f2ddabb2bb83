"""Kernels whose compilation was deferred are compiled by one process for each core."""

from collections.abc import Callable
from pathlib import Path

import pytest

from cairn.system import kernel_compilation


@pytest.mark.parametrize("fails", [False, True])
def test_each_deferred_kernel_is_compiled_once_in_another_process(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    fails: bool,
) -> None:
    monkeypatch.setattr(kernel_compilation, "_deferred", {})
    names = [f"module_{number}.kernel_{kernel}" for number in range(9) for kernel in range(3)]

    def compiler(name: str) -> Callable[[], None]:
        def compile_kernel() -> None:
            (tmp_path / name).open("x").close()  # fails the second time
            if fails and name == names[-1]:
                raise RuntimeError("no memory")

        return compile_kernel

    for name in names:
        kernel_compilation.add_deferred(name.partition(".")[0], compiler(name))

    assert kernel_compilation.compile_deferred() is not fails
    assert ("RuntimeError: no memory" in capfd.readouterr().err) == fails
    assert sorted(path.name for path in tmp_path.iterdir()) == names

"""The cache of results: what is torn, altered or renamed counts as missing."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cairn import CairnError
from cairn_lab.batch.cache import ResultCache
from cairn_lab.batch.task import TaskResult

KEY, OTHER = "ab" * 20, "cd" * 20
RESULT = TaskResult(True, True, "", {"log.txt": b"a line\n" * 50, "numbers": bytes(range(256))})


def entry(cache: ResultCache, key: str = KEY) -> Path:
    return cache.folder / key[:2] / f"{key}.result"


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> ResultCache:
    return ResultCache(tmp_path_factory.mktemp("cache"))


@given(st.data())
def test_torn_or_altered_entry_is_not_trusted(cache: ResultCache, data: st.DataObject) -> None:
    cache.put(KEY, RESULT.encode())
    file = entry(cache)
    whole = file.read_bytes()
    assert cache.get(KEY) == RESULT.encode()
    place = data.draw(st.integers(0, len(whole) - 1))
    torn = data.draw(st.booleans())
    altered = bytearray(whole[:place] if torn else whole)
    if not torn:
        altered[place] ^= data.draw(st.integers(1, 255))

    file.write_bytes(altered)

    assert cache.get(KEY) is None


def test_entry_under_another_key_is_not_trusted(tmp_path: Path) -> None:
    cache = ResultCache(tmp_path)
    cache.put(KEY, RESULT.encode())
    entry(cache, OTHER).parent.mkdir()
    entry(cache).rename(entry(cache, OTHER))

    assert cache.get(OTHER) is None


def test_entries_that_were_not_used_for_the_longest_make_room(tmp_path: Path) -> None:
    sizes = ResultCache(tmp_path / "sizes")
    sizes.put(KEY, RESULT.encode())
    cache = ResultCache(tmp_path / "cache", 3 * entry(sizes).stat().st_size)
    keys = [f"{number:040x}" for number in range(3)]
    for age, key in enumerate(keys):
        cache.put(key, RESULT.encode())
        os.utime(entry(cache, key), (1000 + age, 1000 + age))
    assert cache.get(keys[0]) is not None  # used now

    cache.put(OTHER, RESULT.encode())

    kept = [key for key in (*keys, OTHER) if cache.get(key) is not None]
    assert kept == [keys[0], OTHER]
    assert ResultCache(tmp_path / "cache").get(OTHER) == RESULT.encode()


def test_disk_that_takes_no_data_is_reported_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cache = ResultCache(tmp_path)
    for name in ("ab", "cd"):
        (tmp_path / name).touch()

    cache.put(KEY, RESULT.encode())
    cache.put(OTHER, RESULT.encode())

    assert cache.get(KEY) is None
    assert capsys.readouterr().err.count("results are not kept: File exists") == 1


def test_unusable_folder_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "file").touch()

    with pytest.raises(CairnError, match="use --cache FOLDER or --no-cache"):
        ResultCache(tmp_path / "file" / "cache")


@given(
    st.builds(
        TaskResult,
        st.booleans(),
        st.booleans(),
        st.text(max_size=5),
        st.dictionaries(st.text(max_size=3), st.binary(max_size=9), max_size=3),
        st.text(max_size=5),
    )
)
def test_encoded_result_is_read_back(result: TaskResult) -> None:
    assert TaskResult.decode(result.encode()) == result


@given(st.binary())
def test_other_bytes_are_no_result(data: bytes) -> None:
    with pytest.raises(ValueError, match=r"."):
        TaskResult.decode(data)

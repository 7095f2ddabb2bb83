"""The nearest descriptors are found among few and many, always the same ones."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from cairn.vision.index import PROBES, DescriptorIndex


def clustered(seed: int, count: int) -> NDArray[np.uint8]:
    """Descriptors in some 50 heaps, as real ones are."""
    random = np.random.default_rng(seed)
    heaps = np.random.default_rng(0).integers(0, 120, (50, 128))
    spread = random.normal(0, 12, (count, 128))
    return np.clip(heaps[random.integers(0, 50, count)] + spread, 0, 255).astype(np.uint8)


def exact(descriptors: NDArray[np.uint8], queries: NDArray[np.uint8]) -> NDArray[np.float64]:
    """All distances (q, n)."""
    one, other = queries.astype(np.float64), descriptors.astype(np.float64)
    squares = np.square(one).sum(axis=1)[:, None] + np.square(other).sum(axis=1)
    return np.asarray(np.sqrt(np.maximum(squares - 2 * one @ other.T, 0)))


@given(st.integers(0, 16), st.integers(1, 12), st.integers(0, 2**32 - 1))
def test_among_few_the_nearest_are_found_in_order(known: int, count: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    descriptors = random.integers(0, 256, (known, 128)).astype(np.uint8)
    queries = random.integers(0, 256, (5, 128)).astype(np.uint8)

    found, distances = DescriptorIndex(descriptors).nearest(queries, count)

    some = min(known, count)
    assert round(3 * known**0.5) <= PROBES  # so all lists are looked through
    assert found.shape == distances.shape == (5, count)
    truth = np.sort(exact(descriptors, queries), axis=1)[:, :some]
    np.testing.assert_allclose(distances[:, :some], truth, rtol=1e-5)
    for row in range(5):
        assert len(set(found[row, :some])) == some
    assert (found[:, some:] == -1).all()
    assert np.isinf(distances[:, some:]).all()


def test_among_many_nine_in_ten_nearest_are_found_and_all_distances_are_true() -> None:
    descriptors, queries = clustered(1, 5000), clustered(2, 200)

    found, distances = DescriptorIndex(descriptors).nearest(queries, 5)

    truth = exact(descriptors, queries)
    np.testing.assert_allclose(distances, np.take_along_axis(truth, found, axis=1), rtol=1e-5)
    assert (np.diff(distances, axis=1) >= 0).all()
    assert (found[:, 0] == truth.argmin(axis=1)).mean() > 0.9


def test_what_is_in_it_is_found() -> None:
    descriptors = clustered(3, 3000)

    found, distances = DescriptorIndex(descriptors).nearest(descriptors, 1)

    assert (distances == 0).all()
    assert np.array_equal(descriptors[found[:, 0]], descriptors)


def test_an_index_built_again_answers_the_same() -> None:
    descriptors, queries = clustered(1, 2000), clustered(2, 100)

    one = DescriptorIndex(descriptors).nearest(queries, 8)
    other = DescriptorIndex(descriptors.copy()).nearest(queries, 8)

    assert np.array_equal(one[0], other[0])
    assert np.array_equal(one[1], other[1])


def test_many_copies_of_one_descriptor_are_no_trouble() -> None:
    descriptors = np.tile(clustered(1, 1), (500, 1))

    _, distances = DescriptorIndex(descriptors).nearest(descriptors[:3], 10)

    assert (distances == 0).all()


def test_an_index_of_nothing_finds_nothing() -> None:
    found, distances = DescriptorIndex(np.zeros((0, 128), np.uint8)).nearest(clustered(1, 3), 2)

    assert (found == -1).all()
    assert np.isinf(distances).all()


def test_no_queries_have_no_answers() -> None:
    found, _ = DescriptorIndex(clustered(1, 100)).nearest(np.zeros((0, 128), np.uint8), 2)

    assert found.shape == (0, 2)

"""Tests of the descriptor index."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from cairn.vision.feature_matching import PROBES, DescriptorIndex

pytestmark = pytest.mark.images


def clustered(seed: int, count: int) -> NDArray[np.uint8]:
    """Return descriptors in 50 clusters, like real ones."""
    random = np.random.default_rng(seed)
    clusters = np.random.default_rng(0).integers(0, 120, (50, 128))
    spread = random.normal(0, 12, (count, 128))
    return np.clip(clusters[random.integers(0, 50, count)] + spread, 0, 255).astype(np.uint8)


def exact(descriptors: NDArray[np.uint8], queries: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Return all distances (q, n)."""
    one, other = queries.astype(np.float64), descriptors.astype(np.float64)
    squares = np.square(one).sum(axis=1)[:, None] + np.square(other).sum(axis=1)
    return np.asarray(np.sqrt(np.maximum(squares - 2 * one @ other.T, 0)))


@given(st.integers(0, 16), st.integers(1, 12), st.integers(0, 2**32 - 1))
def test_small_index_finds_nearest_descriptors_in_order(known: int, count: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    descriptors = random.integers(0, 256, (known, 128)).astype(np.uint8)
    queries = random.integers(0, 256, (5, 128)).astype(np.uint8)

    found, distances = DescriptorIndex(descriptors).nearest(queries, count)

    some = min(known, count)
    assert round(3 * known**0.5) <= PROBES  # so all lists are searched
    assert found.shape == distances.shape == (5, count)
    truth = np.sort(exact(descriptors, queries), axis=1)[:, :some]
    np.testing.assert_allclose(distances[:, :some], truth, rtol=1e-5)
    for row in range(5):
        assert len(set(found[row, :some])) == some
    assert (found[:, some:] == -1).all()
    assert np.isinf(distances[:, some:]).all()


def test_large_index_finds_nine_in_ten_nearest_with_true_distances() -> None:
    descriptors, queries = clustered(1, 5000), clustered(2, 200)

    found, distances = DescriptorIndex(descriptors).nearest(queries, 5)

    truth = exact(descriptors, queries)
    np.testing.assert_allclose(distances, np.take_along_axis(truth, found, axis=1), rtol=1e-5)
    assert (np.diff(distances, axis=1) >= 0).all()
    assert (found[:, 0] == truth.argmin(axis=1)).mean() > 0.9


def test_indexed_descriptors_are_found() -> None:
    descriptors = clustered(3, 3000)

    found, distances = DescriptorIndex(descriptors).nearest(descriptors, 1)

    assert (distances == 0).all()
    assert np.array_equal(descriptors[found[:, 0]], descriptors)


def test_index_is_deterministic() -> None:
    descriptors, queries = clustered(1, 2000), clustered(2, 100)

    one = DescriptorIndex(descriptors).nearest(queries, 8)
    other = DescriptorIndex(descriptors.copy()).nearest(queries, 8)

    assert np.array_equal(one[0], other[0])
    assert np.array_equal(one[1], other[1])


def test_many_copies_of_one_descriptor_are_indexed() -> None:
    descriptors = np.tile(clustered(1, 1), (500, 1))

    _, distances = DescriptorIndex(descriptors).nearest(descriptors[:3], 10)

    assert (distances == 0).all()


def test_empty_index_finds_nothing() -> None:
    found, distances = DescriptorIndex(np.zeros((0, 128), np.uint8)).nearest(clustered(1, 3), 2)

    assert (found == -1).all()
    assert np.isinf(distances).all()


def test_no_queries_return_empty_result() -> None:
    found, _ = DescriptorIndex(clustered(1, 100)).nearest(np.zeros((0, 128), np.uint8), 2)

    assert found.shape == (0, 2)

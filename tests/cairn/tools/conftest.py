"""Fixtures of the tests of components that the tests of tools use too."""

from tests.components.conftest import dataset, stage

__all__ = ["dataset", "stage"]

"""Tests of supervision; a package for what they share."""

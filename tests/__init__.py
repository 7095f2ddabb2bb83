"""All tests; a package for what they share."""

"""Components for tests of Cairn in real processes."""

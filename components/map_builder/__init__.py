"""The map builder: owner of the visual map, its reliabilities and its file."""

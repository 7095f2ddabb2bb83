"""The experiments of the paper: one robot, several methods of updating its map, one table."""

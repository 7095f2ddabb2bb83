"""The experiments of the paper: one robot, many ways of keeping its visual map, one table."""

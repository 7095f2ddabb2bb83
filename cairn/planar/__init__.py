"""The plane that robots drive on: poses, grids, scans and compiled kernels; knows no bus."""

"""Paths through free space (RRT and its kin, RRT-GRID, visibility graph) and guide paths traced from floor plans."""

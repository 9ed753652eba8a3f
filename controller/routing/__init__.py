"""Routes through a garage without regard to time: the modified binary tree, and whether an AGV can drive the turns."""

"""Planners: one file each, and one line each in the table ``controller.planners.table.PLANNERS``."""

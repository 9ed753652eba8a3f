"""Layouts, building them into SUMO nets, and reading a net back as a graph."""

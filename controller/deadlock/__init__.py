"""Deadlock: found on the wait-for graph, resolved by a ladder of stages."""

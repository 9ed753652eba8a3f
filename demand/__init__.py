"""Seeded request streams. Knows nothing of the controller."""

"""Seeded request streams. Knows nothing of the controller but the word `Request`."""

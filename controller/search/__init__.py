"""Search for one agent's path among the reservations of the others."""

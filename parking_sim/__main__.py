"""``python -m parking_sim`` is the command ``parking-sim``."""

from parking_sim.cli import main

main()

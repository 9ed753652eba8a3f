"""``python -m parking_sim`` is the command ``parking-sim``."""

import sys

from parking_sim.shadowing import NEEDED_TO_COMPLAIN, hidden_packages


def start() -> None:
    """Run the command line, unless a file in the working directory hides what it is made of."""
    complaint = hidden_packages().get(NEEDED_TO_COMPLAIN)
    if complaint is not None:
        print("error:", complaint, file=sys.stderr)
        raise SystemExit(2)
    from parking_sim.cli import main

    main()


if __name__ == "__main__":
    start()

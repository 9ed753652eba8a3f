"""What a planner says of itself: how its problems are to be made and its answers to be taken."""

from __future__ import annotations

from dataclasses import dataclass, field, fields

from controller.types import Planner
from controller.window import WindowRange


@dataclass(frozen=True, slots=True)
class PlannerFlags:
    """What a planner has set as attributes; these are the defaults.

    Attributes:
        complete: it plans complete paths: it is given only agents that have no path to their goal, ``fixed`` holds
            the present path of every AGV, and the window is endless.
        rests: with ``complete``: every agent always has a path to where it can rest for ever.
        improves: with ``complete``: it wants to know the agents that have a path, ``PlanningProblem.carrying``.
        keeps: without ``complete``: it wants to know what the agents carry out, ``PlanningProblem.carried``.
        one_move: its paths end with one move, before the window does.
        meets_conflicts: without ``complete``: the window goes by the wait-for edges in ``PlanResult.waits``.
        window: the range of its window, where the scenario gives none.

    Raises:
        ValueError: a value of another type, or a flag beside one that it does not go with.
    """

    complete: bool = False
    rests: bool = False
    improves: bool = False
    keeps: bool = False
    one_move: bool = False
    meets_conflicts: bool = False
    window: WindowRange = field(default_factory=WindowRange)

    def __post_init__(self) -> None:
        """Check the values, which may be a user's."""
        for flag in fields(self):
            value: object = getattr(self, flag.name)
            if flag.name == "window":
                if not isinstance(value, WindowRange):
                    raise ValueError(f"window = {value!r}: give WindowRange(start, least, most)")
            elif not isinstance(value, bool):
                raise ValueError(f"{flag.name} = {value!r}: give True or False")
        if (self.rests or self.improves) and not self.complete:
            raise ValueError(f"{'rests' if self.rests else 'improves'} = True: needs complete = True")
        if (self.keeps or self.meets_conflicts) and self.complete:
            raise ValueError(f"{'keeps' if self.keeps else 'meets_conflicts'} = True: not with complete = True")


#: Names of the flags.
FLAGS = tuple(flag.name for flag in fields(PlannerFlags))


def flags_of(planner: Planner) -> PlannerFlags:
    """A planner's flags; a planner without attributes, such as a function, has the defaults.

    Raises:
        ValueError: see ``PlannerFlags``; one line that names the flag.
    """
    return PlannerFlags(**{name: getattr(planner, name) for name in FLAGS if hasattr(planner, name)})

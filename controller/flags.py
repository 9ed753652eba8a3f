"""What a planner says of itself: how its problems are to be made and its answers to be taken."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Protocol

from controller.types import Planner
from controller.window import WindowRange
from sumo_nets.wording import shown


class PlannerFlags(Protocol):
    """What a planner says of itself in attributes, on an object or on a function.

    A planner need not have them: what it lacks has the default that ``Flags`` states. mypy holds a class against this
    protocol where it is assigned to a name of this type.

    Example:
        >>> class Prudent:
        ...     complete, rests, improves, keeps, one_move, meets_conflicts = True, True, False, False, False, False
        ...     window = WindowRange()
        >>> prudent: PlannerFlags = Prudent()
    """

    @property
    def complete(self) -> bool:
        """It plans complete paths.

        It is given only agents that have no path to their goal, ``fixed`` holds the present path of every AGV, and the
        window is endless.
        """
        ...

    @property
    def rests(self) -> bool:
        """With ``complete``: every agent always has a path to where it can rest for ever."""
        ...

    @property
    def improves(self) -> bool:
        """With ``complete``: it wants to know the agents that have a path, ``PlanningProblem.carrying``."""
        ...

    @property
    def keeps(self) -> bool:
        """Without ``complete``: it wants to know what the agents carry out, ``PlanningProblem.carried``."""
        ...

    @property
    def one_move(self) -> bool:
        """Its paths end with one move, before the window does."""
        ...

    @property
    def meets_conflicts(self) -> bool:
        """Without ``complete``: the window goes by the wait-for edges in ``PlanResult.waits``."""
        ...

    @property
    def window(self) -> WindowRange:
        """The range of its window, where the scenario gives none."""
        ...


@dataclass(frozen=True, slots=True)
class Flags:
    """Flags of one planner, checked, with the defaults for those that it lacks. See ``PlannerFlags``.

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
                    raise ValueError(f"window = {shown(value)}: give WindowRange(start, least, most)")
            elif not isinstance(value, bool):
                raise ValueError(f"{flag.name} = {shown(value)}: give True or False")
        if (self.rests or self.improves) and not self.complete:
            raise ValueError(f"{'rests' if self.rests else 'improves'} = True: needs complete = True")
        if (self.keeps or self.meets_conflicts) and self.complete:
            raise ValueError(f"{'keeps' if self.keeps else 'meets_conflicts'} = True: not with complete = True")


#: Names of the flags.
FLAGS = tuple(flag.name for flag in fields(Flags))


def flags_of(planner: Planner) -> Flags:
    """A planner's flags; a planner without attributes, such as a function, has the defaults.

    Raises:
        ValueError: see ``Flags``; one line that names the flag.
    """
    return Flags(**{name: getattr(planner, name) for name in FLAGS if hasattr(planner, name)})

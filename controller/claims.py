"""Who has been promised which bay or charger."""

from __future__ import annotations


class Claims:
    """Each place is promised to one AGV at a time; a bay to another one as well, which comes when that one has left.

    Attributes:
        holder: by place the AGV it is promised to.
        next: by bay the AGV that comes next.
    """

    def __init__(self) -> None:
        self.holder: dict[int, int] = {}
        self.next: dict[int, int] = {}

    def release(self, place: int, agv: int) -> None:
        """The AGV has done what it came for, or does not come."""
        for promised in (self.holder, self.next):
            if promised.get(place) == agv:
                del promised[place]

    def move_up(self) -> None:
        """Let who comes next have the bays that have been released."""
        for bay in [bay for bay in self.next if bay not in self.holder]:
            self.holder[bay] = self.next.pop(bay)

"""When a run in which nothing moves is given up: no request is to come, and nothing can happen before its end."""

from __future__ import annotations

from controller.acs import Acs
from controller.garage import Garage
from parking_sim.plants import Plant

#: Simulated seconds without any task done or vertex granted, with work to do, after which a run is given up, unless a
#: fault is the reason and will end.
STALLED_S = 7200.0

#: Simulated seconds between two looks at whether a run in which nothing moves can go on.
LOOK_S = 10.0


class Standstill:
    """Since when nothing has moved in a run, and whether anything will.

    Args:
        acs, garage: the run's controller and books.
        stuck_s: ``control.stuck_s`` of the scenario, seconds.
        step_s: seconds a step lasts.
    """

    def __init__(self, acs: Acs, garage: Garage, stuck_s: float, step_s: float) -> None:
        self._acs, self._garage = acs, garage
        self._patience_s = stuck_s + 2 * LOOK_S
        self._look_every = max(1, round(LOOK_S / step_s))
        self._mark = (0, 0, 0)
        self._moved_s = 0.0

    def moved(self, now_s: float) -> None:
        """Begin to wait anew: what a fault held needs its time now."""
        self._moved_s = now_s

    def watch(self, now_s: float) -> None:
        """Look for progress; to be called at each step."""
        agvs, executor = self._acs.executor.agvs, self._acs.executor
        mark = (sum(executor.moves), self._garage.unfinished, sum(a.acted for a in agvs))
        if mark != self._mark or self._garage.unfinished == 0:
            self._mark, self._moved_s = mark, now_s

    def is_final(self, step: int, now_s: float, end_s: float, plant: Plant) -> bool:
        """Nothing has moved for very long, or nothing can happen any more before the end.

        Args:
            step: the step now; most of them are not looked at.
            now_s, end_s: now, and the run's end, seconds.
            plant: says which faults end, and which AGVs they hold.
        """
        quiet_s = now_s - self._moved_s
        if step % self._look_every or quiet_s < self._patience_s:
            return False
        return not self._something_ends(step, end_s, plant) if quiet_s >= STALLED_S else self._for_ever(end_s, plant)

    def _something_ends(self, step: int, end_s: float, plant: Plant) -> bool:
        """An action under way, or a fault that holds an AGV or a request, will end before the run does."""
        acting = any(a.acting_until > step for a in self._acs.executor.agvs)
        ending = plant.ending(end_s)
        return acting or any(ending.intersection(hold.faults) for hold in self._acs.holds.of_all())

    def _for_ever(self, end_s: float, plant: Plant) -> bool:
        still = plant.still(end_s)
        return still is not None and self._acs.holds.for_ever(still)

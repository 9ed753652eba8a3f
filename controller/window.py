"""The planning window: how far ahead the planner looks. It adapts to the traffic.

Two rules exist. *Score* is the rule of the thesis's program (2025; the thesis itself leaves the rule open). Its
congestion score is ``floor(keep * old) + wait edges + scc * SCCs``, over the conflicts met while planning. SCCs are the
strongly connected components (rings of waiting agents) of the wait-for graph. The window grows by a step above ``up``
and shrinks by a step below ``down``. This rule needs a planner that reports conflicts.

*Traffic* suits planners that search around reservations. Such planners meet no conflicts, and few AGVs really wait. The
thesis names the idea as future work: the density of requests and the frequency of deadlocks set the window, the limits
of partial CBS and StuckBoost. The level of traffic, 0 to 1, is ``keep * old + (1 - keep) * now``. While a deadlock is
open ``now`` is 1; otherwise it is the share of AGVs under way, not counting the first one. Level 0 gives the least
window and level 1 the greatest, in whole steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import networkx as nx

from controller.types import AgvNumber


@dataclass(frozen=True, slots=True)
class WindowRange:
    """Window sizes that suit a planner, in moves: first, least and greatest. The defaults are the thesis's.

    Raises:
        ValueError: the sizes are not in order, or one is below 1.
    """

    start: int = 5
    least: int = 5
    most: int = 11

    def __post_init__(self) -> None:
        """Check the order."""
        if not 1 <= self.least <= self.start <= self.most:
            raise ValueError(f"{self}: give 1 <= least <= start <= most")


@dataclass(frozen=True, slots=True)
class WindowRule:
    """How the window adapts.

    Attributes:
        step: change of the window at a time, moves.
        keep: share of the old score or level that is kept at each planning call.
        scc: weight of a strongly connected component in the score.
        up, down: the window grows when the score is above ``up`` and shrinks below ``down``.
    """

    step: int = 2
    keep: float = 0.6
    scc: int = 5
    up: int = 24
    down: int = 10


class Window:
    """The window of one run.

    Args:
        moves: least, greatest and first window.
        rule: how it adapts.

    Attributes:
        cells: the window now, moves.
        score: the congestion score; 0 under the rule of traffic.
        level: how much of its range the window takes up, 0 to 1.
    """

    def __init__(self, moves: WindowRange, rule: WindowRule) -> None:
        self._moves = moves
        self._rule = rule
        self.cells = moves.start
        self.score = 0
        self.level = (moves.start - moves.least) / max(1, moves.most - moves.least)

    def take_conflicts(self, edges: int, sccs: int) -> None:
        """Adapt by the score.

        Args:
            edges: wait-for edges that the planner met in this call.
            sccs: strongly connected components of two or more among them.
        """
        moves, rule = self._moves, self._rule
        self.score = int(rule.keep * self.score) + edges + rule.scc * sccs
        if self.score > rule.up:
            self.cells = min(moves.most, self.cells + rule.step)
        elif self.score < rule.down:
            self.cells = max(moves.least, self.cells - rule.step)
        self.level = (self.cells - moves.least) / max(1, moves.most - moves.least)

    def take_traffic(self, under_way: int, agvs: int, deadlock: bool) -> None:
        """Adapt by density and deadlocks.

        Args:
            under_way: AGVs that have somewhere to go.
            agvs: AGVs in all.
            deadlock: some deadlock is open.
        """
        moves, rule = self._moves, self._rule
        now = 1.0 if deadlock else max(0, under_way - 1) / max(1, agvs - 1)
        self.level = rule.keep * self.level + (1 - rule.keep) * now
        steps = round(self.level * (moves.most - moves.least) / rule.step)
        self.cells = min(moves.most, moves.least + steps * rule.step)


def count_sccs(edges: Sequence[tuple[AgvNumber, AgvNumber]]) -> int:
    """Strongly connected components with at least two agents in a wait-for graph."""
    graph: nx.DiGraph[AgvNumber] = nx.DiGraph(edges)
    return sum(len(members) > 1 for members in nx.strongly_connected_components(graph))

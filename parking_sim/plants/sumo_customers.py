"""Customers' cars in SUMO: they come by the street, wait in line, stand at a bay, and drive off.

A car that comes waits in a backlog until there is room for it on the entry edge; only one car at a time is offered to
SUMO. Then it drives up to the hold line. Called forward, it drives on to the bay's inbound parkingArea. It vanishes
when an AGV has lifted it, and appears again at the outbound parkingArea when an AGV has set it down there.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from parking_sim.plants import CarAtBay, CarLeft, PlantEvent
from parking_sim.plants.sumo_files import CUSTOMER_IN, CUSTOMER_OUT

if TYPE_CHECKING:
    from sumo_nets.read import BaySite, GarageNet, Street

_FOREVER_S = 1e9
#: Cars that SUMO holds on the entry edge; further ones wait in the backlog and count as spilled just the same. Each
#: standing car costs SUMO 1 to 2 us a step.
MAX_ON_ENTRY = 8
#: Steps between two looks whether there is room on the entry edge.
ENTRY_STEPS = 4


@dataclass(frozen=True, slots=True)
class StreetState:
    """Customers who wait.

    Attributes:
        queued: cars that stand on the queue edge.
        spilled: cars that stand on the street before it, or have found no room there yet.
    """

    queued: int
    spilled: int


class Customers:
    """All customers' cars of one simulation.

    Args:
        api: libsumo or traci, with a simulation running.
        garage: the net.
    """

    def __init__(self, api: Any, garage: GarageNet) -> None:
        self.events: list[PlantEvent] = []
        self._api = api
        self._street: Street | None = garage.street
        self._sites: Mapping[int, BaySite] = garage.bay_sites
        self._backlog: deque[str] = deque()
        self._patience = 0  # steps until the entry edge is looked at again
        self._entering = ""  # offered to SUMO, not on the street yet
        self._inside: set[str] = set()  # on the street or at an inbound place
        self._calls: dict[str, int] = {}  # called forward, not told to SUMO yet
        self._driving: dict[str, int] = {}  # on the way to a bay
        self._placing: dict[str, int] = {}  # retrieved, not at the outbound place yet
        self._outbound: dict[int, str] = {}  # whose each bay's outbound place is
        self._leaving: dict[str, int] = {}  # at the outbound place or driving off it
        self._impatient: set[str] = set()  # told to drive off before they stood in SUMO
        if self._street is not None:
            api.route.add("customer_in", (self._street.entry_edge, self._street.queue_edge))
            for bay, site in self._sites.items():
                api.route.add(f"bay_in{bay}", tuple(site.in_route))
                api.route.add(f"bay_out{bay}", tuple(site.out_route))

    def arrive(self, car: str) -> None:
        """A car joins the end of the line."""
        if self._street is None:
            raise self._api.TraCIException("the net has no street for customers")
        self._backlog.append(car)

    def call_forward(self, car: str, bay: int) -> None:
        """Send a waiting car on to a bay, as soon as SUMO accepts it."""
        self._calls[car] = bay

    def hand_over(self, car: str, bay: int) -> None:
        """A retrieved car is to stand at a bay's outbound place, as soon as the one before it has left."""
        self._placing[car] = bay
        if bay not in self._outbound:
            self._offer_place(car, bay)

    def drive_off(self, car: str) -> None:
        """A retrieved car leaves its outbound place."""
        if car in self._placing:
            self._impatient.add(car)
        else:
            self._api.vehicle.resume(car)

    def take(self, car: str) -> None:
        """An AGV has lifted a car: if it stood at a bay, it is no longer SUMO's."""
        if car in self._inside:
            self._inside.discard(car)
            self._api.vehicle.remove(car, 1)

    def before_step(self) -> None:
        """Hand SUMO what it can take now."""
        if self._backlog and not self._entering:
            self._patience -= 1
            if self._patience <= 0:
                self._patience = ENTRY_STEPS
                if self._on_entry() < MAX_ON_ENTRY:
                    self._enter(self._backlog.popleft())
        if self._calls:
            for car in [c for c in self._calls if c in self._inside]:
                self._send(car, self._calls[car])

    def after_step(self) -> None:
        """See what happened; fills ``events``."""
        self.events = []
        simulation = self._api.simulation
        if self._entering and self._entering in simulation.getDepartedIDList():
            self._inside.add(self._entering)
            self._entering = ""
        if self._driving or self._placing:
            for car in simulation.getParkingStartingVehiclesIDList():
                if car in self._driving:
                    self.events.append(CarAtBay(car, self._driving.pop(car)))
                elif car in self._placing:
                    self._stand_outbound(car)
        if self._leaving:
            for car in simulation.getParkingEndingVehiclesIDList():
                if car in self._leaving:
                    self._free_place(car, self._leaving.pop(car))

    def street(self) -> StreetState:
        """Cars that wait now."""
        if self._street is None or not (self._inside or self._backlog or self._entering):
            return StreetState(0, 0)
        halting = self._api.edge.getLastStepHaltingNumber
        outside = len(self._backlog) + bool(self._entering)
        return StreetState(halting(self._street.queue_edge), halting(self._street.entry_edge) + outside)

    def _on_entry(self) -> int:
        return self._api.edge.getLastStepVehicleNumber(self._street.entry_edge) if self._street else 0

    def _enter(self, car: str) -> None:
        assert self._street is not None
        self._entering = car
        self._api.vehicle.add(car, "customer_in", CUSTOMER_IN, departPos="base", departSpeed="max")
        self._api.vehicle.setStop(car, self._street.queue_edge, self._street.hold_pos_m, duration=_FOREVER_S)

    def _send(self, car: str, bay: int) -> None:
        """Drive on from the hold line, or without stopping there; refused on a junction, so wait for the next edge."""
        assert self._street is not None
        vehicle, site = self._api.vehicle, self._sites[bay]
        road = vehicle.getRoadID(car)
        if road.startswith(":"):
            return
        del self._calls[car]
        waiting = vehicle.isStopped(car)
        before = () if road == self._street.queue_edge else (road,)
        vehicle.setRoute(car, (*before, *site.in_route))
        vehicle.setParkingAreaStop(car, site.in_area, duration=_FOREVER_S)
        if waiting:
            vehicle.resume(car)
        else:
            vehicle.setStop(car, self._street.queue_edge, self._street.hold_pos_m, duration=0.0)
        self._driving[car] = bay

    def _free_place(self, car: str, bay: int) -> None:
        self.events.append(CarLeft(car, bay))
        del self._outbound[bay]
        waiting = [c for c, b in self._placing.items() if b == bay]
        if waiting:
            self._offer_place(waiting[0], bay)

    def _offer_place(self, car: str, bay: int) -> None:
        self._outbound[bay] = car
        self._api.vehicle.add(car, f"bay_out{bay}", CUSTOMER_OUT, departPos="stop", departSpeed="0")
        self._api.vehicle.setParkingAreaStop(car, self._sites[bay].out_area, duration=_FOREVER_S)

    def _stand_outbound(self, car: str) -> None:
        self._leaving[car] = self._placing.pop(car)
        if car in self._impatient:
            self._impatient.discard(car)
            self._api.vehicle.resume(car)

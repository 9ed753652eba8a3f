"""Customers' cars in SUMO: they come by the street, wait in line, stand at a bay, and drive off.

A car that comes waits in a backlog until there is room for it on the entry edge; only one car at a time is offered to
SUMO. Then it drives up to the hold line. Called forward, it drives on to the bay's inbound parkingArea. It vanishes
when an AGV has lifted it, and appears again at the outbound parkingArea when an AGV has set it down there.

SUMO knows a car by the number of its request, not by its own name: a car may bear any name, even an AGV's, and may come
back while SUMO still sees it drive off.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from parking_sim.plants import CarAtBay, CarLeft, PlantEvent, StreetState
from parking_sim.plants.sumo_files import CUSTOMER_IN, CUSTOMER_OUT, customer_name, request_of

if TYPE_CHECKING:
    from controller.types import RequestNumber
    from sumo_nets.numbering import Vertex
    from sumo_nets.read import GarageNet
    from sumo_nets.street import BaySite, Street

_FOREVER_S = 1e9
#: Cars that SUMO holds on the entry edge; further ones wait in the backlog and count as spilled just the same. Each
#: standing car costs SUMO 1 to 2 us a step.
MAX_ON_ENTRY = 8
#: Steps between two looks whether there is room on the entry edge.
ENTRY_STEPS = 4


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
        self._sites: Mapping[Vertex, BaySite] = garage.bay_sites
        self._backlog: deque[RequestNumber] = deque()
        self._patience = 0  # steps until the entry edge is looked at again
        self._entering: RequestNumber | None = None  # offered to SUMO, not on the street yet
        self._inside: set[RequestNumber] = set()  # on the street or at an inbound place
        self._calls: dict[RequestNumber, Vertex] = {}  # called forward to which bay, not told to SUMO yet
        self._driving: dict[RequestNumber, Vertex] = {}  # on the way to which bay
        self._placing: dict[RequestNumber, Vertex] = {}  # retrieved, to which bay, not at its outbound place yet
        self._outbound: dict[Vertex, RequestNumber] = {}  # bay -> whose its outbound place is
        self._leaving: dict[RequestNumber, Vertex] = {}  # at which bay's outbound place, or driving off it
        self._impatient: set[RequestNumber] = set()  # told to drive off before they stood in SUMO
        if self._street is not None:
            api.route.add("customer_in", (self._street.entry_edge, self._street.queue_edge))
            for bay, site in self._sites.items():
                api.route.add(f"bay_in{bay}", tuple(site.in_route))
                api.route.add(f"bay_out{bay}", tuple(site.out_route))

    def arrive(self, request: RequestNumber) -> None:
        """The car of a request joins the end of the line."""
        if self._street is None:
            raise self._api.TraCIException("the net has no street for customers")
        self._backlog.append(request)

    def call_forward(self, request: RequestNumber, bay: Vertex) -> None:
        """Send a waiting car on to a bay, as soon as SUMO accepts it."""
        self._calls[request] = bay

    def hand_over(self, request: RequestNumber, bay: Vertex) -> None:
        """A retrieved car is to stand at a bay's outbound place, as soon as the one before it has left."""
        self._placing[request] = bay
        if bay not in self._outbound:
            self._offer_place(request, bay)

    def drive_off(self, request: RequestNumber) -> None:
        """A retrieved car leaves its outbound place."""
        if request in self._placing:
            self._impatient.add(request)
        else:
            self._api.vehicle.resume(customer_name(request))

    def take(self, request: RequestNumber) -> None:
        """An AGV has lifted a car: if it stood at a bay, it is no longer SUMO's."""
        if request in self._inside:
            self._inside.discard(request)
            self._api.vehicle.remove(customer_name(request), 1)

    def before_step(self) -> None:
        """Hand SUMO what it can take now."""
        if self._backlog and self._entering is None:
            self._patience -= 1
            if self._patience <= 0:
                self._patience = ENTRY_STEPS
                if self._on_entry() < MAX_ON_ENTRY:
                    self._enter(self._backlog.popleft())
        if self._calls:
            for request in [r for r in self._calls if r in self._inside]:
                self._send(request, self._calls[request])

    def after_step(self) -> None:
        """See what happened; fills ``events``."""
        self.events = []
        simulation = self._api.simulation
        if self._entering is not None and customer_name(self._entering) in simulation.getDepartedIDList():
            self._inside.add(self._entering)
            self._entering = None
        if self._driving or self._placing:
            for request in map(request_of, simulation.getParkingStartingVehiclesIDList()):
                if request in self._driving:
                    self.events.append(CarAtBay(request, self._driving.pop(request)))
                elif request in self._placing:
                    self._stand_outbound(request)
        if self._leaving:
            for request in map(request_of, simulation.getParkingEndingVehiclesIDList()):
                if request in self._leaving:
                    self._free_place(request, self._leaving.pop(request))

    def street(self) -> StreetState:
        """Cars that wait now."""
        if self._street is None or not (self._inside or self._backlog or self._entering is not None):
            return StreetState(0, 0)
        halting = self._api.edge.getLastStepHaltingNumber
        outside = len(self._backlog) + (self._entering is not None)
        return StreetState(halting(self._street.queue_edge), halting(self._street.entry_edge) + outside)

    def _on_entry(self) -> int:
        return self._api.edge.getLastStepVehicleNumber(self._street.entry_edge) if self._street else 0

    def _enter(self, request: RequestNumber) -> None:
        assert self._street is not None
        self._entering, car = request, customer_name(request)
        self._api.vehicle.add(car, "customer_in", CUSTOMER_IN, departPos="base", departSpeed="max")
        self._api.vehicle.setStop(car, self._street.queue_edge, self._street.hold_pos_m, duration=_FOREVER_S)

    def _send(self, request: RequestNumber, bay: Vertex) -> None:
        """Drive on from the hold line, or without stopping there; refused on a junction, so wait for the next edge."""
        assert self._street is not None
        vehicle, site, car = self._api.vehicle, self._sites[bay], customer_name(request)
        road = vehicle.getRoadID(car)
        if road.startswith(":"):
            return
        del self._calls[request]
        waiting = vehicle.isStopped(car)
        before = () if road == self._street.queue_edge else (road,)
        vehicle.setRoute(car, (*before, *site.in_route))
        vehicle.setParkingAreaStop(car, site.in_area, duration=_FOREVER_S)
        if waiting:
            vehicle.resume(car)
        else:
            vehicle.setStop(car, self._street.queue_edge, self._street.hold_pos_m, duration=0.0)
        self._driving[request] = bay

    def _free_place(self, request: RequestNumber, bay: Vertex) -> None:
        self.events.append(CarLeft(request, bay))
        del self._outbound[bay]
        waiting = [r for r, b in self._placing.items() if b == bay]
        if waiting:
            self._offer_place(waiting[0], bay)

    def _offer_place(self, request: RequestNumber, bay: Vertex) -> None:
        self._outbound[bay], car = request, customer_name(request)
        self._api.vehicle.add(car, f"bay_out{bay}", CUSTOMER_OUT, departPos="stop", departSpeed="0")
        self._api.vehicle.setParkingAreaStop(car, self._sites[bay].out_area, duration=_FOREVER_S)

    def _stand_outbound(self, request: RequestNumber) -> None:
        self._leaving[request] = self._placing.pop(request)
        if request in self._impatient:
            self._impatient.discard(request)
            self._api.vehicle.resume(customer_name(request))

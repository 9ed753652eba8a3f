"""Customers' cars in real SUMO: the street, the bays, hand-over and driving off."""

import pytest

from controller.types import Act, Action, Advance, CallForward, DriveOff, HandOver
from parking_sim.plants import CarAtBay, CarLeft, StreetState
from parking_sim.plants.sumo import PlantError, SumoPlant
from parking_sim.plants.sumo_agv import AgvType
from parking_sim.plants.sumo_customers import MAX_ON_ENTRY
from sumo_nets.read import read_net

#: Numbers of requests.
BLUE, FIRST, SECOND = 0, 1, 2


@pytest.fixture
def plant():
    garage = read_net("map1")
    made = SumoPlant(garage, [garage.graph.bays[0], garage.graph.homes[0]], AgvType(), 1)
    yield made
    made.close()


def run(plant, steps):
    """Step and collect (time, event)."""
    seen = []
    for _ in range(steps):
        plant.step()
        seen += [(plant.time_s, event) for event in plant.events()]
    return seen


def alive(plant):
    """Requests whose cars SUMO has now."""
    return {
        int(name.removeprefix("customer")) for name in plant._api.vehicle.getIDList() if name.startswith("customer")
    }


def test_a_customer_parks_and_leaves(plant):
    plant.arrive(BLUE)
    assert plant.street() == StreetState(0, 1)
    run(plant, 120)
    assert plant.street() == StreetState(1, 0)
    plant.execute(CallForward(BLUE, 0))
    assert [event for _, event in run(plant, 120)] == [CarAtBay(BLUE, 0)]
    assert plant.street() == StreetState(0, 0)

    plant.execute(Act(0, Action.LIFT, 40, BLUE))
    run(plant, 39)
    assert BLUE in alive(plant)
    run(plant, 2)
    assert BLUE not in alive(plant)

    plant.execute(Act(0, Action.LOWER, 30, BLUE))
    run(plant, 30)
    plant.execute(HandOver(BLUE, 0))
    assert run(plant, 20) == []
    assert BLUE in alive(plant)
    plant.execute(DriveOff(BLUE, 0))
    assert [event for _, event in run(plant, 20)] == [CarLeft(BLUE, 0)]
    run(plant, 120)
    assert BLUE not in alive(plant)


def test_called_forward_at_any_time(plant):
    """Before it is on the street, on the way, on the junction before the bays, or at the hold line."""
    for n, delay in enumerate((0, 1, 15, 30, 45, 60, 75, 90, 200)):
        plant.arrive(n)
        run(plant, delay)
        plant.execute(CallForward(n, n % 2))
        assert [event for _, event in run(plant, 250)] == [CarAtBay(n, n % 2)], delay
        plant._customers.take(n)
        run(plant, 2)
        assert n not in alive(plant)


def test_the_next_car_moves_up_and_places_are_used_again(plant):
    for n in range(4):
        plant.arrive(n)
    plant.execute(CallForward(0, 0))
    plant.execute(CallForward(1, 1))
    assert {event for _, event in run(plant, 200)} == {CarAtBay(0, 0), CarAtBay(1, 1)}
    assert plant.street() == StreetState(2, 0)
    plant.execute(Act(0, Action.LIFT, 40, 0))
    run(plant, 41)
    plant.execute(CallForward(2, 0))
    assert [event for _, event in run(plant, 100)] == [CarAtBay(2, 0)]


def test_the_outbound_place_takes_one_car_after_the_other(plant):
    plant.execute(HandOver(FIRST, 0))
    plant.execute(HandOver(SECOND, 0))
    plant.execute(DriveOff(SECOND, 0))
    assert run(plant, 40) == []
    assert alive(plant) & {FIRST, SECOND} == {FIRST}
    plant.execute(DriveOff(FIRST, 0))
    assert [event for _, event in run(plant, 60)] == [CarLeft(FIRST, 0), CarLeft(SECOND, 0)]


def test_a_full_street_is_counted(plant):
    for n in range(60):
        plant.arrive(n)
    run(plant, 400)
    street = plant.street()
    assert street.queued + street.spilled == 60
    assert 8 <= street.queued <= 15
    assert len(alive(plant)) <= street.queued + MAX_ON_ENTRY + 1
    before = street.spilled
    plant.execute(CallForward(0, 0))
    run(plant, 200)
    assert plant.street().spilled == before - 1


def test_an_agv_may_move_while_customers_come(plant):
    plant.arrive(BLUE)
    plant.execute(Advance(1, (plant.graph.successors[plant.graph.homes[0]][0],)))
    run(plant, 60)
    assert plant.states()[1].reached == 1
    assert plant.collisions == 0


def test_no_street_no_customers():
    garage = read_net("map1_thesis")
    plant = SumoPlant(garage, garage.graph.homes[:1], AgvType(), 1)
    try:
        with pytest.raises(PlantError, match="no street"):
            plant.arrive(BLUE)
        assert plant.street() == StreetState(0, 0)
    finally:
        plant.close()

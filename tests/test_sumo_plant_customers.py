"""Customers' cars in real SUMO: the street, the bays, hand-over and driving off."""

import pytest

from controller.types import Act, Action, Advance, CallForward, DriveOff, HandOver
from parking_sim.plants import CarAtBay, CarLeft
from parking_sim.plants.sumo import PlantError, SumoPlant
from parking_sim.plants.sumo_agv import AgvType
from parking_sim.plants.sumo_customers import MAX_ON_ENTRY, StreetState
from sumo_nets.read import read_net


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
    return set(plant._api.vehicle.getIDList())


def test_a_customer_parks_and_leaves(plant):
    plant.arrive("blue")
    assert plant.street() == StreetState(0, 1)
    run(plant, 120)
    assert plant.street() == StreetState(1, 0)
    plant.execute(CallForward("blue", 0))
    assert [event for _, event in run(plant, 120)] == [CarAtBay("blue", 0)]
    assert plant.street() == StreetState(0, 0)

    plant.execute(Act(0, Action.LIFT, 40, "blue"))
    run(plant, 39)
    assert "blue" in alive(plant)
    run(plant, 2)
    assert "blue" not in alive(plant)

    plant.execute(Act(0, Action.LOWER, 30, "blue"))
    run(plant, 30)
    plant.execute(HandOver("blue", 0))
    assert run(plant, 20) == []
    assert "blue" in alive(plant)
    plant.execute(DriveOff("blue", 0))
    assert [event for _, event in run(plant, 20)] == [CarLeft("blue", 0)]
    run(plant, 120)
    assert "blue" not in alive(plant)


def test_called_forward_at_any_time(plant):
    """Before it is on the street, on the way, on the junction before the bays, or at the hold line."""
    for n, delay in enumerate((0, 1, 15, 30, 45, 60, 75, 90, 200)):
        car = f"car{n}"
        plant.arrive(car)
        run(plant, delay)
        plant.execute(CallForward(car, n % 2))
        assert [event for _, event in run(plant, 250)] == [CarAtBay(car, n % 2)], delay
        plant._customers.take(car)
        run(plant, 2)
        assert car not in alive(plant)


def test_the_next_car_moves_up_and_places_are_used_again(plant):
    for n in range(4):
        plant.arrive(f"car{n}")
    plant.execute(CallForward("car0", 0))
    plant.execute(CallForward("car1", 1))
    assert {event for _, event in run(plant, 200)} == {CarAtBay("car0", 0), CarAtBay("car1", 1)}
    assert plant.street() == StreetState(2, 0)
    plant.execute(Act(0, Action.LIFT, 40, "car0"))
    run(plant, 41)
    plant.execute(CallForward("car2", 0))
    assert [event for _, event in run(plant, 100)] == [CarAtBay("car2", 0)]


def test_the_outbound_place_takes_one_car_after_the_other(plant):
    plant.execute(HandOver("first", 0))
    plant.execute(HandOver("second", 0))
    plant.execute(DriveOff("second", 0))
    assert run(plant, 40) == []
    assert alive(plant) & {"first", "second"} == {"first"}
    plant.execute(DriveOff("first", 0))
    assert [event for _, event in run(plant, 60)] == [CarLeft("first", 0), CarLeft("second", 0)]


def test_a_full_street_is_counted(plant):
    for n in range(60):
        plant.arrive(f"car{n}")
    run(plant, 400)
    street = plant.street()
    assert street.queued + street.spilled == 60
    assert 8 <= street.queued <= 15
    assert len(alive(plant)) - 2 <= street.queued + MAX_ON_ENTRY + 1
    before = street.spilled
    plant.execute(CallForward("car0", 0))
    run(plant, 200)
    assert plant.street().spilled == before - 1


def test_an_agv_may_move_while_customers_come(plant):
    plant.arrive("blue")
    plant.execute(Advance(1, (plant.graph.successors[plant.graph.homes[0]][0],)))
    run(plant, 60)
    assert plant.states()[1].reached == 1
    assert plant.collisions == 0


def test_no_street_no_customers():
    garage = read_net("map1_thesis")
    plant = SumoPlant(garage, garage.graph.homes[:1], AgvType(), 1)
    try:
        with pytest.raises(PlantError, match="no street"):
            plant.arrive("blue")
        assert plant.street() == StreetState(0, 0)
    finally:
        plant.close()

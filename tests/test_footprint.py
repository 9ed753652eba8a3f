"""Rectangles: distances against an independent formula, and what counts as an overlap."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from shapely import Polygon

from parking_sim.footprint import REACH_M, Bodies, FootprintCheck, rectangle_distance

metres = st.floats(-6.0, 6.0)
half_sizes = st.floats(0.2, 3.0)
angles = st.floats(-math.pi, math.pi)


@st.composite
def rectangles(draw):
    angle = draw(angles)
    return np.array([draw(metres), draw(metres), math.cos(angle), math.sin(angle), draw(half_sizes), draw(half_sizes)])


def corners(r):
    along, across = np.array([r[2], r[3]]) * r[4], np.array([-r[3], r[2]]) * r[5]
    return [r[:2] + along + across, r[:2] + along - across, r[:2] - along - across, r[:2] - along + across]


def inside(point, r):
    d = point - r[:2]
    return abs(d @ [r[2], r[3]]) <= r[4] and abs(d @ [-r[3], r[2]]) <= r[5]


def between_segments(p, q, r, s):
    """Distance of two segments by crossing test and end points."""

    def side(a, b, c):
        return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])

    def to_segment(point, a, b):
        t = np.clip((point - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        return float(np.hypot(*(a + t * (b - a) - point)))

    if side(p, q, r) * side(p, q, s) < 0 and side(r, s, p) * side(r, s, q) < 0:
        return 0.0
    return min(to_segment(p, r, s), to_segment(q, r, s), to_segment(r, p, q), to_segment(s, p, q))


def slow_distance(a, b):
    ca, cb = corners(a), corners(b)
    if any(inside(p, b) for p in ca) or any(inside(p, a) for p in cb):
        return 0.0
    return min(between_segments(ca[i - 1], ca[i], cb[j - 1], cb[j]) for i in range(4) for j in range(4))


@settings(max_examples=300, deadline=None)
@given(rectangles(), rectangles())
def test_distance_agrees_with_segment_by_segment(a, b):
    assert rectangle_distance(a, b) == pytest.approx(slow_distance(a, b), abs=1e-6)
    assert rectangle_distance(a, b) == pytest.approx(rectangle_distance(b, a), abs=1e-9)


@settings(max_examples=30, deadline=None)
@given(rectangles(), rectangles())
def test_distance_agrees_with_sampled_points(a, b):
    grid = np.linspace(-1.0, 1.0, 25)
    u, v = (m.ravel() for m in np.meshgrid(grid, grid))

    def points(r):
        along, across = np.array([r[2], r[3]]) * r[4], np.array([-r[3], r[2]]) * r[5]
        return r[:2] + np.outer(u, along) + np.outer(v, across)

    pa, pb = points(a), points(b)
    sampled = float(np.hypot(*(pa[:, np.newaxis] - pb[np.newaxis]).transpose(2, 0, 1)).min())
    assert rectangle_distance(a, b) <= sampled + 1e-9
    assert sampled <= rectangle_distance(a, b) + 0.4


@pytest.mark.parametrize(
    ("x", "y", "angle", "clear"),
    [(0, 0, 0, 0), (6, 0, 0, 1), (0, 3, 0, 1), (6, 3, 0, math.sqrt(2)), (0, 0, 90, 0), (0, 5, 90, 1.5), (5, 0, 0, 0)],
)
def test_by_hand(x, y, angle, clear):
    a = np.array([0.0, 0.0, 1.0, 0.0, 2.5, 1.0])
    b = np.array([x, y, math.cos(math.radians(angle)), math.sin(math.radians(angle)), 2.5, 1.0])
    assert rectangle_distance(a, b) == pytest.approx(clear)


def bodies(*fronts, loaded=()):
    x, y, degrees = np.array(fronts, dtype=float).T
    n = len(fronts)
    carry = np.array([i in loaded for i in range(n)])
    return Bodies(x, y, np.radians(degrees), np.full(n, 5.0), np.full(n, 2.0), carry)


def test_overlaps_are_counted_once_each_time_and_by_step():
    check = FootprintCheck()
    check.step(0.5, bodies((0, 0, 0), (8, 0, 0)))
    assert check.result().agvs.clear_m == pytest.approx(3.0)
    for t in (1.0, 1.5, 2.0):  # they stand in each other: each step counts
        check.step(t, bodies((0, 0, 0), (4, 0, 0)))
    check.step(2.5, bodies((0, 0, 0), (8, 0, 0)))
    check.step(2.75, bodies((0, 0, 0), (8, 0, 0)))
    check.step(3.0, bodies((0, 0, 0), (4, 1, 0)))
    result = check.result()
    assert (result.overlaps, result.overlap_steps, result.least_m) == (2, 4, 0.0)
    assert [(e.time_s, e.agv, e.other) for e in check.events] == [(1.0, 0, 1), (3.0, 0, 1)]


def test_far_bodies_are_not_measured():
    check = FootprintCheck()
    check.step(0.5, bodies((0, 0, 0), (5 + REACH_M + 1, 20, 0)))
    assert check.result().agvs is None
    assert check.result().least_m == math.inf


@pytest.mark.parametrize("front", [-11.9, 11.9])
def test_parked_cars_of_any_length_are_looked_at(front):
    """Once another AGV has passed close by, only what is nearer still is measured."""

    def long(*fronts, loaded=()):
        given = bodies(*fronts, loaded=loaded)
        return replace(given, length=np.full(len(fronts), 12.0))

    check = FootprintCheck()
    check.step(0.5, long((0, 0, 0), (0, 100, 0), loaded=(0,)))
    check.lowered("bus", 0)
    check.step(1.0, long((-90, 0, 0), (0, 2.1, 0), loaded=(1,)))
    assert check.result().parked.clear_m == pytest.approx(0.1)
    check.step(1.5, long((-90, 0, 0), (front, 0, 0), loaded=(1,)))
    assert [(e.agv, e.other) for e in check.events] == [(1, "bus")]


#: Where AGV 0 is when it has driven straight out from under a car at the origin.
AWAY = (90, 60, 0)


def park_at_origin(angle=0.0, other=(0, 100, 0)):
    """A car set down with its front at the origin by AGV 0, which then has driven off; AGV 1 is elsewhere."""
    check = FootprintCheck()
    check.step(0.5, bodies((0, 0, angle), other, loaded=(0,)))
    check.lowered("blue", 0)
    away = (60 * math.cos(math.radians(angle)), 60 * math.sin(math.radians(angle)), angle)
    check.step(1.0, bodies(away, other))
    check.step(1.0, bodies(AWAY, other))
    assert check.result().overlaps == 0
    return check


def test_passing_a_parked_car():
    check = park_at_origin()
    check.step(1.5, bodies(AWAY, (0, 2.5, 0)))
    near = check.result().parked
    assert (near.agv, near.other) == (1, "blue")
    assert near.clear_m == pytest.approx(0.5)
    check.step(2.0, bodies(AWAY, (0, 1.5, 0)))
    assert check.result().overlaps == 1
    assert check.events[0].other == "blue"


def counts(check):
    """Overlaps, and turns in slots that are too short."""
    return check.result().overlaps, check.result().turns_under_cars


def test_only_an_empty_agv_gets_under_a_car_and_only_along_its_axis():
    for loaded, overlaps in (((), 0), ((1,), 1)):
        check = park_at_origin()
        for n, x in enumerate(np.arange(-12.0, 0.0, 0.7)):
            check.step(2.0 + n, bodies(AWAY, (x, 0, 0), loaded=loaded))
        assert counts(check) == (overlaps, 0)
    check = park_at_origin(other=(-2.5, -60, 90))
    for n, y in enumerate(np.arange(-6.0, 0.0, 0.7)):  # from the side
        check.step(2.0 + n, bodies(AWAY, (-2.5, y, 90)))
    assert counts(check) == (1, 0)


@pytest.mark.parametrize("step_m", [0.05, 0.5, 3.0, 9.0])
def test_straight_in_under_a_car_and_out_again_is_no_overlap_at_any_length_of_step(step_m):
    axis = np.array([math.cos(math.radians(30)), math.sin(math.radians(30))])
    check = park_at_origin(30.0, other=(*(-60 * axis), 30))
    for n, along in enumerate([*np.arange(-12.0, 0.0, step_m), *np.arange(0.0, -12.0, -step_m)]):
        check.step(2.0 + n, bodies(AWAY, (*(along * axis), 30)))
    assert counts(check) == (0, 0)
    assert check.result().parked is None or check.result().parked.agv == 0


@pytest.mark.parametrize("loaded", [(), (1,)])
def test_an_agv_at_a_right_angle_under_a_car_is_counted(loaded):
    """However it got there: this is the first time that it is seen near the car."""
    check = park_at_origin()
    check.step(2.0, bodies(AWAY, (-2.5, 2.5, 90), loaded=loaded))
    assert counts(check) == (1, 0)
    assert check.events[0].other == "blue"


def out_from_under(poses, cramped=False):
    """What is counted of an AGV that has set down a car at the origin and then stands as told."""
    check = FootprintCheck()
    check.step(0.5, bodies((0, 0, 0), loaded=(0,)))
    check.lowered("blue", 0, cramped)
    for n, pose in enumerate(poses):
        check.step(1.0 + n, bodies(pose))
    return counts(check)


def swung(rear, aside, degrees):
    """Where the front is when the rear is at a place."""
    angle = math.radians(degrees)
    return rear + 5 * math.cos(angle), aside + 5 * math.sin(angle), degrees


@pytest.mark.parametrize(
    ("rear", "cramped", "expected"), [(-3.0, False, (1, 0)), (-3.0, True, (0, 1)), (1.1, False, (0, 0))]
)
def test_a_turn_under_the_car_that_was_set_down_is_counted_and_one_beside_it_is_not(rear, cramped, expected):
    """The rear is on the car's axis while the front swings round."""
    assert out_from_under([swung(rear, 0, degrees) for degrees in (0, 15, 29, 45, 60, 80)], cramped) == expected


def test_with_a_car_there_is_no_turn_under_another_one_wherever_it_stands():
    check = FootprintCheck()
    check.standing(["blue"], bodies((0, 0, 0)), [True])
    check.step(1.0, bodies(swung(-3, 0, 50), loaded=(0,)))
    assert counts(check) == (1, 0)


@pytest.mark.parametrize(("degrees", "aside", "overlaps"), [(25, 0.0, 0), (34, 0.2, 0), (36, 0.0, 1), (25, 0.4, 1)])
def test_out_from_under_a_car_in_the_bend_of_a_spur(degrees, aside, overlaps):
    """The front swings out a little while the rear is on the car's axis."""
    assert out_from_under([swung(-3, aside, degrees)]) == (overlaps, 0)


def test_an_agv_that_lifts_a_car_may_be_in_its_place_before_the_car_is_gone():
    check = park_at_origin(other=(0, 40, 180))
    check.step(1.5, bodies(AWAY, (40, 0, 180)))
    check.step(2.0, bodies(AWAY, (0, 0, 180)))
    assert counts(check) == (0, 0)
    check = park_at_origin(other=(-40, 0, 0))
    check.step(2.0, bodies(AWAY, (0.01, 0, 0)))
    check.step(2.5, bodies(AWAY, (0.01, 0, 0), loaded=(1,)))
    assert counts(check) == (0, 0)
    check.step(3.0, bodies(AWAY, (0.5, 0, 0), loaded=(1,)))
    assert counts(check) == (1, 0)


@settings(max_examples=200, deadline=None)
@given(
    st.tuples(metres, metres, st.floats(-180.0, 180.0)),
    st.one_of(st.floats(-180.0, 180.0), st.sampled_from([0.0, 20.0, -28.0, 180.0, 160.0, 37.0])),
    st.floats(-7.0, 7.0),
    st.one_of(st.floats(-4.0, 4.0), st.floats(-0.5, 0.5)),
    st.booleans(),
)
def test_one_agv_near_one_car_against_polygons(car, turned, along, aside, loaded):
    """What is counted, told from polygons and from the car's frame of reference."""
    x, y, angle = car
    axis = np.array([math.cos(math.radians(angle)), math.sin(math.radians(angle))])
    side = np.array([-axis[1], axis[0]])
    heading = math.radians(angle + turned)
    ahead = np.array([math.cos(heading), math.sin(heading)])
    front = np.array([x, y]) - 2.5 * axis + along * axis + aside * side + 2.5 * ahead
    check = FootprintCheck()
    check.standing(["blue"], bodies(car), [False])
    check.step(1.0, bodies((*front, angle + turned), loaded=(0,) if loaded else ()))

    theirs = (Polygon(corners(_rectangle(car))), Polygon(corners(_rectangle((*front, angle + turned)))))
    near_m = theirs[0].distance(theirs[1])
    half = np.array([math.cos(math.radians(turned)), math.sin(math.radians(turned))]) * 2.5
    ends = sorted((np.array([along, aside]) + way * half for way in (1, -1)), key=lambda end: abs(end[0]))
    sharp = min(abs(turned) % 180, 180 - abs(turned) % 180)
    assume(abs(sharp - 35) > 1e-3 and abs(abs(ends[0][1]) - 0.3) > 1e-6 and not 0 < near_m < 1e-6)
    assume(abs(abs(ends[0][0]) - abs(ends[1][0])) > 1e-6 or sharp == 0)
    aligned = sharp <= 35 and abs(ends[0][1]) <= 0.3
    allowed = aligned and (not loaded or math.hypot(along, aside) <= 0.3)
    assert counts(check) == (near_m == 0 and not allowed, 0)


def test_straight_from_under_one_car_in_under_another():
    """Across an aisle an AGV is under both for a while; another one that comes from the side is not."""
    check = FootprintCheck()
    check.step(0.5, bodies((0, 0, 0), (8, 0, 0), (4, 50, 0), loaded=(0, 1, 2)))
    check.lowered("from", 0)
    check.lowered("to", 1)
    check.step(1.0, bodies((0, 0, 0), (60, 0, 0), (4, 50, 0)))
    for n, x in enumerate(np.arange(0.5, 8.0, 0.5)):
        check.step(2.0 + n, bodies((x, 0, 0), (60, 0, 0), (4, 50, 0)))
    assert counts(check) == (0, 0)
    check.step(20.0, bodies((8, 0, 0), (60, 0, 0), (5.5, -3, 90)))
    check.step(21.0, bodies((8, 0, 0), (60, 0, 0), (5.5, 0, 90)))
    assert [(event.agv, event.other) for event in check.events if event.other == "to"] == [(2, "to")]


def test_a_lifted_car_is_gone():
    check = park_at_origin()
    with pytest.raises(KeyError):
        check.lowered("blue", 1)
    check.lifted("blue")
    check.lifted("unknown")
    check.step(1.5, bodies(AWAY, (0, 0.5, 30), loaded=(1,)))
    assert check.result().overlaps == 0


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_many_bodies_against_every_pair(seed):
    """The culling of far bodies loses nothing: overlaps and least clearances as from all pairs."""
    random = np.random.default_rng(seed)
    n, cars = 12, 30
    check = FootprintCheck()
    spots = np.stack([random.uniform(0, 60, cars), random.uniform(0, 60, cars), random.uniform(0, 360, cars)], 1)
    check.standing([f"c{k}" for k in range(cars)], bodies(*spots), [False] * cars)
    fronts = np.stack([random.uniform(0, 60, n), random.uniform(0, 60, n), random.uniform(0, 360, n)], 1)
    check.step(1.0, bodies(*fronts, loaded=range(n)))
    agvs = [_rectangle(f) for f in fronts]
    parked = [_rectangle(s) for s in spots]
    pairs = [(rectangle_distance(agvs[i], agvs[j]), i, j) for i in range(n) for j in range(i)]
    with_cars = [(rectangle_distance(agvs[i], parked[k]), i, k) for i in range(n) for k in range(cars)]
    result = check.result()
    assert result.overlaps == sum(d == 0 for d, _, _ in pairs + with_cars)
    for near, least in ((result.agvs, min(pairs)[0]), (result.parked, min(with_cars)[0])):
        if least < REACH_M:
            assert near.clear_m == pytest.approx(least)


def _rectangle(front):
    x, y, angle = front[0], front[1], math.radians(front[2])
    c, s = math.cos(angle), math.sin(angle)
    return np.array([x - 2.5 * c, y - 2.5 * s, c, s, 2.5, 1.0])


# --- between two steps ------------------------------------------------------------------------------------------------


def polygon(pose, length=5.0, width=2.0):
    """A body by the middle of its front side, with nothing of the check's."""
    x, y, degrees = pose
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return Polygon(
        [
            (x - b * c - a * s, y - b * s + a * c)
            for b in (0, length)
            for a in ((width / 2, -width / 2)[:: 1 if b else -1])
        ]
    )


def along(start, end, t):
    """Straight on by the middle of the body, its axis turning evenly the shorter way."""
    middles = [
        np.array([x - 2.5 * math.cos(math.radians(a)), y - 2.5 * math.sin(math.radians(a))]) for x, y, a in (start, end)
    ]
    angle = start[2] + t * ((end[2] - start[2] + 90) % 180 - 90)
    middle = middles[0] + t * (middles[1] - middles[0])
    return (*(middle + 2.5 * np.array([math.cos(math.radians(angle)), math.sin(math.radians(angle))])), angle)


poses = st.tuples(st.floats(-6, 6), st.floats(-6, 6), st.floats(-180, 180))
steps = st.tuples(st.floats(-1.4, 1.4), st.floats(-1.4, 1.4), st.floats(-10, 10))


def moved(pose, step):
    """A pose whose middle has gone on by so many metres, turned by so many degrees; an AGV may have reversed."""
    x, y, angle = along(pose, pose, 0.0)
    middle = np.array([x, y]) - 2.5 * np.array([math.cos(math.radians(angle)), math.sin(math.radians(angle))])
    turned = math.radians(angle + step[2])
    front = middle + np.array(step[:2]) + 2.5 * np.array([math.cos(turned), math.sin(turned)])
    return (*front, angle + step[2])


@settings(max_examples=80, deadline=None)
@given(poses, steps, poses, steps)
def test_what_two_bodies_do_between_two_steps_against_dense_sampling(a, to_b, c, to_d):
    """AGV 0 goes from a to b while AGV 1 goes from c to d; polygons of 200 moments tell the least room."""
    b, d = moved(a, to_b), moved(c, to_d)
    check = FootprintCheck()
    check.step(1.0, bodies(a, c))
    check.step(2.0, bodies(b, d))
    parts = np.linspace(0, 1, 201)
    sampled = min(polygon(along(a, b, t)).distance(polygon(along(c, d, t))) for t in parts)
    found = min(check.result().least_m, REACH_M)
    assert found <= min(sampled, REACH_M) + 0.011
    assert found >= min(sampled, REACH_M) - 2 * (2.0 + math.radians(10) * 2.7) / 200


def test_a_body_that_goes_far_in_a_step_is_looked_at_in_the_steps_alone():
    """It may have gone round what lies on the straight way."""
    check = FootprintCheck()
    check.step(0.5, bodies((-4, 0, 0), (3, 0, 90)))
    check.step(1.0, bodies((12, 0, 0), (3, 0, 90)))
    assert check.result().overlaps == 0


def test_an_agv_that_swings_under_a_car_between_two_steps_is_seen():
    """It stands aligned under the car in both steps, the other way round in the second one."""
    check = FootprintCheck()
    check.step(0.5, bodies((0, 0, 0), loaded=(0,)))
    check.lowered("blue", 0)
    check.step(1.0, bodies((-60, 0, 0)))
    check.step(1.5, bodies((-3, 0, 0)))
    assert counts(check) == (0, 0)
    check.step(2.0, bodies((-3, 0.0, 50)))
    assert counts(check) == (1, 0)


def test_more_overlaps_in_a_step_than_there_is_room_for_are_counted_up_to_it():
    """100 AGVs in one place touch 4,950 times; 4,096 of these are listed, and the step counts as far."""
    check = FootprintCheck()
    check.step(0.5, bodies(*[(0.01 * n, 0.0, 0.0) for n in range(100)]))
    assert check.result().overlaps == 4096
    check.step(1.0, bodies(*[(20.0 * n, 0.0, 0.0) for n in range(100)]))
    assert check.result().overlaps == 4096


@pytest.mark.parametrize(("tip", "overlaps"), [(2.35, 1), (2.6, 1), (2.75, 0)])
def test_a_body_that_turns_on_the_spot_sweeps_what_it_does_not_touch_at_either_step(tip, overlaps):
    """From -45 to +45 degrees its corners reach 2.69 m ahead on the way, but it reaches 1.41 m before and after."""
    check = FootprintCheck()
    for time_s, degrees in ((0.5, -45.0), (1.0, 45.0)):
        nose = 2.5 * math.cos(math.radians(degrees)), 2.5 * math.sin(math.radians(degrees)), degrees
        given = bodies(nose, (tip, 0.0, 180.0))
        check.step(time_s, replace(given, length=np.array([5.0, 3.0]), width=np.array([2.0, 0.2])))
    assert check.result().overlaps == overlaps

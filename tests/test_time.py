"""Steps and seconds: what a step may last, what is rounded to steps, and whose clock says what."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controller.types import Motion, whole_steps
from parking_sim.assembly import assemble, control_options
from parking_sim.config import ControlConfig, check_scenario
from parking_sim.simulation import simulate
from sumo_nets.errors import InputError

milliseconds = st.integers(1, 1000)


def scenario(**keys):
    return check_scenario({"garage": "map1", "agvs": 2, **keys}, "test", Path())


@settings(deadline=None)
@given(st.integers(0, 10**7), milliseconds)
def test_whole_steps_are_the_fewest_that_last_as_long(time_ms, step_ms):
    steps = whole_steps(time_ms / 1000, step_ms / 1000)
    assert steps * step_ms >= time_ms > (steps - 1) * step_ms


@settings(deadline=None)
@given(st.integers(0, 10**7), milliseconds)
def test_a_number_of_steps_lasts_a_whole_number_of_milliseconds(steps, step_ms):
    none = np.zeros((2, 0), dtype=np.int32)
    motion = Motion(step_ms / 1000, none, none, none, none[0], following=False)
    assert motion.seconds(steps) == float(Fraction(steps * step_ms, 1000))


@pytest.mark.parametrize("step_s", [0.1, 0.5, 0.9, 1.0])
def test_the_controllers_times_hold_at_every_step_of_sumo(step_s):
    """At 1 s, too: that is no tick of the discrete plant."""
    options = control_options(ControlConfig(period_s=18.0, stuck_s=90.0), "sumo", 13, step_s)
    assert (options.period_steps, options.ladder.stuck_steps) == (round(18 / step_s), round(90 / step_s))
    assert control_options(ControlConfig(period_s=18.0), "discrete", 1, step_s).period_steps == 1


def test_a_step_of_one_second_plans_no_more_often_than_a_shorter_one():
    calls = []
    for step_s in (0.9, 1.0):
        keys = {"step_s": step_s, "duration_s": 400, "control": {"period_s": 20.0}}
        calls.append(simulate(scenario(**keys), None).metrics["planning_calls"])
    assert calls[1] <= 1.2 * calls[0]


@pytest.mark.parametrize(
    ("step_s", "give"),
    [(0.0166667, "0.016 or 0.017"), (0.0125, "0.012 or 0.013"), (0.0015, "0.001 or 0.002"), (0.0004, "0.001")],
)
def test_a_step_that_sumo_would_cut_is_refused(step_s, give):
    with pytest.raises(InputError, match=f"step_s: {step_s!r}: SUMO's step is whole milliseconds; give {give}$"):
        scenario(step_s=step_s)


@settings(deadline=None)
@given(milliseconds)
def test_whole_milliseconds_are_accepted(step_ms):
    assert scenario(step_s=step_ms / 1000).step_s == step_ms / 1000


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"duration_s": 0.4}, "duration_s: 0.4: shorter than step_s, 0.5 s; give 0.5 or more"),
        ({"max_time_s": 0.4}, "max_time_s: 0.4: shorter"),
        ({"record": {"sample_s": 0.4}}, "record.sample_s: 0.4: shorter"),
        ({"control": {"period_s": 0.4}}, "control.period_s: 0.4: shorter"),
        ({"control": {"timeout_s": 0.4}}, "control.timeout_s: 0.4: shorter"),
        ({"plant": "discrete", "record": {"sample_s": 0.9}}, "record.sample_s: 0.9: shorter than a tick"),
    ],
)
def test_what_cannot_be_done_more_often_than_each_step_is_refused(keys, message):
    with pytest.raises(InputError, match=message):
        assemble(scenario(**keys))

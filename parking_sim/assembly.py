"""From a scenario to the parts of a run. What a scenario can get wrong is found here, before anything is written."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np

from controller.acs import Acs, Setup
from controller.deadlock.ladder import LadderLimits
from controller.dispatch import DISPATCH
from controller.events import Log
from controller.fleet import StuckBoost
from controller.garage import Customers, Garage
from controller.planners.cbs import CbsLimits
from controller.planners.guest import PlannerError
from controller.planners.table import load_planner
from controller.planning import ControlOptions
from controller.rules import Rules
from controller.types import AgvNumber, Motion, whole_steps
from controller.window import WindowRule
from demand.types import Demand, stream
from demand.workloads import make_demand
from parking_sim.config import AgvConfig, ControlConfig, PlantKind, Scenario, unknown_names
from parking_sim.faults import scripted_faults
from parking_sim.plants import Plant
from parking_sim.plants.faulty import BreakablePlant, FaultyPlant
from parking_sim.rulesets import RULE_SETS, TickRules
from sumo_nets.check import require_fit
from sumo_nets.doors import one_door_each
from sumo_nets.errors import InputError
from sumo_nets.in_use import chosen_homes, first_places
from sumo_nets.numbering import Numbered, Vertex
from sumo_nets.passing import crowded
from sumo_nets.read import GarageNet, read_net
from sumo_nets.wording import one_of

if TYPE_CHECKING:
    from parking_sim.plants.sumo_agv import AgvType


@dataclass(frozen=True, eq=False)
class World:
    """The parts of one run.

    Attributes:
        scenario: what was asked.
        net: the garage's net.
        homes: home vertex of each AGV.
        demand: what the customers want.
        motion, rules: durations for planning and for work at the goals.
    """

    scenario: Scenario
    net: GarageNet
    homes: Numbered[AgvNumber, Vertex]
    demand: Demand
    motion: Motion
    rules: Rules

    def plant(self, outputs: Path | None, gui: bool, fcd: bool) -> BreakablePlant:
        """Start the plant; with SUMO this loads the net."""
        if self.scenario.plant == "discrete":
            from parking_sim.plants.discrete import DiscretePlant

            ticks = _ticks(self.scenario)
            return DiscretePlant(self.net.graph, self.motion, self.homes, ticks.charge_after_cells)
        from parking_sim.plants.sumo import SumoPlant

        s = self.scenario
        return SumoPlant(self.net, self.homes, agv_type(s.agv), s.seed, s.step_s, gui, outputs, fcd)

    def with_faults(self, plant: BreakablePlant) -> Plant:
        """The plant with the scenario's faults; in SUMO at least batteries that run flat."""
        s = self.scenario
        can_fail = s.faults.any or s.plant == "sumo"
        return FaultyPlant(plant, s.faults, self.homes, s.seed) if can_fail else plant

    def garage(self) -> Garage:
        """Empty books, then the cars that are there at the start."""
        customers, seed = self.scenario.customers, self.scenario.seed
        behaviour = Customers(
            0.0 if self.scenario.plant == "discrete" else customers.handling_median_s,
            customers.handling_sigma,
            customers.balk_cars,
            None if customers.balk_min is None else 60 * customers.balk_min,
        )
        garage = Garage(self.net.graph, self.net.handover, stream(seed, "handling"), behaviour)
        garage.place_initial(self.demand.initial_cars, stream(seed, "initial slots"))
        return garage

    def acs(self, garage: Garage, log: Log) -> Acs:
        """The controller.

        Raises:
            InputError: a planner's file or option that can't be used.
        """
        s, graph = self.scenario, self.net.graph
        try:
            limit_s = s.control.planner_limit_s
            planner = load_planner(s.planner_source, graph, self.motion, s.planner_options, limit_s)
        except PlannerError:
            raise
        except ValueError as error:
            raise InputError(f"planner: {error}") from None
        options = control_options(s.control, s.plant, self.rules.cell_steps, self.motion.step_s)
        prescribed = _ticks(s).dispatch if s.plant == "discrete" else ""
        rule = DISPATCH[prescribed or s.dispatch]
        return Acs(Setup(graph, self.motion, self.homes, garage, self.rules, options, planner, rule, log, perf_counter))


def assemble(scenario: Scenario) -> World:
    """Check a scenario against its garage and build what does not need a running plant.

    Raises:
        InputError: an unknown planner, dispatch rule or rule set, more AGVs than homes, a demand that does not fit.
        NetError: an unknown net, or one of which ``parking-sim check-net`` complains.
    """
    for key, wrong in unknown_names(scenario):
        raise InputError(f"{key}: {wrong}")
    whole = read_net(scenario.garage_source)
    require_fit(whole, scenario.agv.size_m)
    net = chosen_homes(first_places(whole, scenario.bays, scenario.chargers), scenario.homes)
    homes = net.graph.homes
    if scenario.agvs > len(homes):
        raise InputError(f"agvs: {scenario.agvs}: {net.name} has homes for 1 to {len(homes)}")
    if crowd := crowded(one_door_each(net).graph, scenario.agvs):
        raise InputError(f"agvs: {scenario.agvs}: {net.name}: {crowd}")
    if net.handover == "home" and (scenario.customers.balk_cars or scenario.customers.balk_min):
        raise InputError(f"customers: balk_cars, balk_min: {net.name} has no queue: cars are handed over at homes")
    demand = make_demand(scenario.workload, len(net.graph.slots), scenario.seed, scenario.base_dir)
    _check_zones(demand, net)
    scripted_faults(scenario.faults, net.graph, scenario.agvs)
    if scenario.plant == "discrete":
        ticks = _ticks(scenario)
        motion, rules = ticks.motion(net.graph, scenario.planner), ticks.rules(scenario.planner)
    else:
        from parking_sim.plants.sumo_agv import sumo_motion

        net = one_door_each(net)
        kind = agv_type(scenario.agv)
        motion = sumo_motion(net.graph, kind, scenario.step_s)
        rules = _sumo_rules(scenario.agv, motion)
    _check_times(scenario, motion.step_s)
    return World(scenario, net, tuple(homes)[: scenario.agvs], demand, motion, rules)


def _check_times(scenario: Scenario, step_s: float) -> None:
    """Whatever is done again and again, or ends the run, can't be shorter than a step."""
    times = {"max_time_s": scenario.max_time_s, "record.sample_s": scenario.record.sample_s}
    if scenario.duration_s is not None:
        times["duration_s"] = scenario.duration_s
    if scenario.plant == "sumo":
        control = scenario.control
        for key in ("period_s", "look_ahead_s", "timeout_s", "stuck_s"):
            times[f"control.{key}"] = getattr(control, key)
    for field, seconds in times.items():
        if seconds < step_s:
            step = "step_s" if scenario.plant == "sumo" else "a tick of the discrete plant"
            raise InputError(f"{field}: {seconds:g}: shorter than {step}, {step_s:g} s; give {step_s:g} or more")


def _check_zones(demand: Demand, net: GarageNet) -> None:
    zones = {request.zone for phase in demand.phases for request in phase if request.zone}
    slots = [net.graph.names[v] for v in net.graph.slots]
    for zone in sorted(zones):
        if not any(slot.startswith(zone) for slot in slots):
            raise InputError(
                f"workload: zone {zone!r}: no slot's name begins so; {one_of(slots, zone)}, or its beginning"
            )


def _ticks(scenario: Scenario) -> TickRules:
    return RULE_SETS[scenario.rules]


def agv_type(config: AgvConfig) -> AgvType:
    """The plant's AGV from the scenario's."""
    from parking_sim.plants.sumo_agv import AgvType

    return AgvType(**config.model_dump(include={f.name for f in fields(AgvType)}))


def _sumo_rules(config: AgvConfig, motion: Motion) -> Rules:
    def steps(seconds: float) -> int:
        return whole_steps(seconds, motion.step_s)

    full_charge_s = config.battery_wh / config.charge_w * 3600.0
    return Rules(
        lift_slot=steps(config.lift_s),
        lower_slot=steps(config.lower_s),
        lift_bay=steps(config.lift_s),
        lower_bay=steps(config.lower_s),
        charge_below=config.charge_below,
        charge_to=config.charge_to,
        charge_steps=steps(full_charge_s),
        charge_least_steps=1,
        assign_on_return=True,
        cell_steps=int(np.median(motion.edge_steps[1])),
    )


def control_options(config: ControlConfig, plant: PlantKind, cell_steps: int, step_s: float) -> ControlOptions:
    """The controller's options in its own units: times in SUMO, numbers of moves in the discrete plant."""

    def steps(seconds: float, moves: int) -> int:
        return whole_steps(seconds, step_s) if plant == "sumo" else moves * cell_steps

    ladder = LadderLimits(
        patience_steps=2 * cell_steps,
        stuck_steps=steps(config.stuck_s, 20),
        group=config.cbs_group,
        cbs=CbsLimits(
            expansions=config.cbs_expansions, nodes=config.cbs_nodes, constraints=config.cbs_constraints, ranges=True
        ),
    )
    return ControlOptions(
        period_steps=steps(config.period_s, 1),
        replanning=config.replanning,
        look_ahead_steps=steps(config.look_ahead_s, 8),
        timeout_steps=steps(config.timeout_s, 5),
        watch_steps=steps(1.0, 1),
        reorder=config.reorder,
        window_cells=config.window_cells,
        window_min=config.window_min,
        window_max=config.window_max,
        window=WindowRule(config.window_step, config.score_keep, config.score_scc, config.score_up, config.score_down),
        boost=StuckBoost(config.boost_step, config.boost_after, config.boost_max),
        ladder=ladder,
        adapt_boost=config.adapt_boost,
        adapt_cbs=config.adapt_cbs,
    )

"""Paper 002, the thesis on parking-lot AGVs (2025), tables 2-1 to 2-7: A*, D* Lite and the pipeline, row by row.

Each cell of a table is run under the thesis's rules, under equal ("fair") rules, and in SUMO on the thesis's grids. The
pipeline is our default planner with deadlock handling. What the rules are and what came out: docs/thesis.md.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd
import yaml

from parking_sim.config import Scenario, load_scenario
from parking_sim.reproduce.findings import Finding, findings_table, make_folder, write_findings

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: The thesis's planners and ours. The pipeline is whatever a scenario gets that names no planner.
PLANNERS: Mapping[str, str] = {
    "pipeline": str(Scenario.model_fields["planner"].default),
    "astar": "astar",
    "dstar_lite": "dstar_lite",
}
THESIS, FAIR, SUMO = "thesis", "fair", "sumo"

#: Metric -> heading. Completion and conflicts go first.
METRICS: Mapping[str, str] = {
    "completion": "share of tasks done",
    "conflicts": "vertex and swap conflicts seen (SUMO: collisions and overlaps)",
    "throughput": "table 2-1: throughput, tasks a step",
    "movement_cost": "table 2-2: movement cost, cells",
    "nodes_expanded": "table 2-3: nodes expanded",
    "heap_moves": "table 2-4: heap moves",
    "nodes_generated": "table 2-5: nodes generated",
    "valid_expansions": "table 2-6: valid expansions",
    "valid_ratio": "table 2-7: valid expansions / generated",
    "steps": "steps (paper: the authors' program run again)",
    "bound_share": "throughput as a share of the bound",
    "slot_choice_expanded": "nodes expanded to choose slots",
}

#: Metrics of the runs beyond the thesis's tables.
BEYOND = ("completion", "conflicts", "throughput", "steps", "nodes_expanded", "bound_share")

#: Demand seeds of the comparison of planners.
SEEDS = range(10)
#: AGVs beyond the thesis's.
MORE_AGVS: Mapping[str, tuple[int, ...]] = {"map2": (8, 12, 16), "map3": (16, 32, 48)}
#: Simulated seconds after which a run in SUMO is given up.
SUMO_LIMIT_S = 1_000_000.0


@dataclass(frozen=True, slots=True)
class Case:
    """One run.

    Attributes:
        garage: map1, map2 or map3; the run is on its thesis grid.
        agvs: number of AGVs.
        planner: a name of ``PLANNERS``.
        rules: "thesis", "fair" or "sumo".
        cars: cars to park; None for as many as there are slots.
        park_only: the run ends with the last car parked.
        seed: seed of the order in which cars are fetched; None for the order in which they came.
    """

    garage: str
    agvs: int
    planner: str
    rules: str
    cars: int | None = None
    park_only: bool = False
    seed: int | None = None

    def scenario(self) -> Scenario:
        """The run's scenario."""
        order = "parked" if self.seed is None else "random"
        workload = {"kind": "park_exit", "cars": self.cars, "park_only": self.park_only, "order": order}
        plant = "sumo" if self.rules == SUMO else "discrete"
        keys: dict[str, object] = {
            "agvs": self.agvs,
            "plant": plant,
            "planner": PLANNERS[self.planner],
            "dispatch": "nearest",
            "workload": workload,
            "seed": self.seed or 0,
            "record": {"sample_s": 2.0 if plant == "sumo" else 1.0},
        }
        keys |= {"max_time_s": SUMO_LIMIT_S} if plant == "sumo" else {"rules": self.rules}
        return load_scenario(f"{self.garage}_thesis", keys)


def reproduce(folder: Path, full: bool, workers: int = 2) -> None:
    """Run the tables, print them and write them with the runs, the claims and a figure for each metric.

    Args:
        folder: where ``thesis-runs.csv``, ``thesis.csv``, ``thesis.md`` and the figures go.
        full: all rows with all cars, park and fetch on every map, more AGVs, and the comparison over demand seeds;
            else MAP1, and MAP2 with 40 cars, and a single run in SUMO.
        workers: processes.

    Raises:
        InputError: the folder can't be written.
    """
    make_folder(folder)
    rows = ROWS if full else QUICK_ROWS
    cases = [case for case in table_cases(rows) if full or case.rules != SUMO or _quick_in_sumo(case)]
    if full:
        cases += [*seed_cases(), *park_and_fetch_cases()]
        cases.sort(key=lambda case: case.rules == SUMO)  # they take longest
    runs = run_cases(cases, workers, folder / "thesis-runs.csv")
    tables = runs[runs["seed"].isna() & ~runs["extra"]]
    text = "".join(f"{METRICS[metric]}\n\n{metric_table(tables, metric)}\n" for metric in METRICS)
    if full:
        beyond = runs[runs["extra"]]
        text += "".join(f"park and fetch, {METRICS[m]}\n\n{metric_table(beyond, m, False)}\n" for m in BEYOND)
    findings = [*claims(tables), *best_planners(runs)]
    write_findings(findings, folder, "thesis")
    (folder / "thesis.md").write_text(text + findings_table(findings), encoding="utf-8")
    for metric in METRICS:
        draw(tables, metric).savefig(folder / f"thesis-{metric}.svg", metadata={"Date": None})
    print(text + findings_table(findings), end="")
    print(f"tables and figures: {folder}")


#: (garage, AGVs, cars, park only) of the tables' rows; the quick form has 40 cars on MAP2 and leaves MAP3 out.
Row = tuple[str, int, int | None, bool]
ROWS: Sequence[Row] = (
    *(("map1", n, None, False) for n in (1, 2, 3, 4)),
    ("map2", 4, None, True),
    ("map3", 8, None, True),
)
QUICK_ROWS: Sequence[Row] = (*ROWS[:4], ("map2", 4, 40, True))


def _quick_in_sumo(case: Case) -> bool:
    """SUMO takes long: the quick form has the pipeline with 4 AGVs on MAP1 only."""
    return case.garage == "map1" and case.agvs == 4 and case.planner == "pipeline"


def table_cases(rows: Sequence[Row]) -> Iterator[Case]:
    """Each row under each planner, under the thesis's rules, under fair ones and in SUMO."""
    for garage, agvs, cars, park_only in rows:
        for planner in PLANNERS:
            for rules in (THESIS, FAIR, SUMO):
                yield Case(garage, agvs, planner, rules, cars, park_only)


def park_and_fetch_cases() -> Iterator[Case]:
    """Park and fetch under fair rules on MAP2 and MAP3, with the thesis's AGVs and with more."""
    for garage, agvs in (("map2", 4), ("map3", 8)):
        for n in (agvs, *MORE_AGVS[garage]):
            for planner in PLANNERS:
                yield Case(garage, n, planner, FAIR)


def seed_cases() -> Iterator[Case]:
    """Every row with cars fetched by name in a random order, under fair rules, over the demand seeds."""
    for garage, agvs, _, _ in ROWS:
        for planner in PLANNERS:
            for seed in SEEDS:
                yield Case(garage, agvs, planner, FAIR, seed=seed)


def run_cases(cases: Sequence[Case], workers: int, file: Path) -> pd.DataFrame:
    """Run cases in parallel processes; a row for each, in their order, which is in the file as soon as it is known."""
    from parking_sim.executors import open_executor

    rows = []
    with open_executor(workers) as executor:
        for row in executor.map(run_case, cases):
            rows.append(row)
            first = len(rows) == 1
            pd.DataFrame([row]).to_csv(file, mode="w" if first else "a", header=first, index=False, float_format="%.6g")
            if sys.stderr.isatty():
                print(f"\r{len(rows)} of {len(cases)} runs", end="", file=sys.stderr, flush=True)
    return pd.DataFrame(rows)


def run_case(case: Case) -> dict[str, Any]:
    """Run one case, and look at what happened independently of the controller."""
    from analysis.tables import load_run
    from analysis.tick_conflicts import meetings
    from parking_sim.simulation import simulate

    scenario = case.scenario()
    with tempfile.TemporaryDirectory() as name:
        summary = simulate(scenario, Path(name))
        m = dict(summary.metrics)
        if case.rules == SUMO:
            m["conflicts"] = m["sumo_collisions"] + m["footprint_overlaps"]
        else:
            m["conflicts"] = len(meetings(load_run(Path(name)).trajectory))
    m["completion"] = m["tasks_done"] / m["tasks_wanted"]
    m["bound_share"] = float("nan") if case.rules == SUMO else m["throughput"] * bound_steps(scenario) / m["tasks_done"]
    extra = case.rules == FAIR and case.seed is None and not case.park_only and case.garage != "map1"
    return {**asdict(case), "extra": extra, "status": summary.status, **{metric: m[metric] for metric in METRICS}}


def bound_steps(scenario: Scenario) -> int:
    """Steps that no controller can do a discrete park-and-fetch scenario in."""
    from analysis.bound import least_steps
    from parking_sim.assembly import assemble

    world = assemble(scenario)
    parks = world.demand.phases[0]
    return least_steps(
        world.net.graph, world.motion, world.rules, world.homes, len(parks), park_only=len(world.demand.phases) == 1
    )


# --- tables -----------------------------------------------------------------------------------------------------------


def published() -> Any:
    """The thesis's printed figures and those of its program run again, see ``thesis.yaml``."""
    return yaml.safe_load(files("parking_sim.reproduce").joinpath("thesis.yaml").read_text(encoding="utf-8"))


def paper_value(metric: str, planner: str, garage: str, agvs: int, cars: float | None) -> float | None:
    """What the thesis says of a cell; None where it says nothing."""
    paper = published()
    row = [garage, agvs]
    if row not in paper["rows"] or (cars is not None and not pd.isna(cars)):
        return None
    values = paper["rerun"][planner]["steps"] if metric == "steps" else paper["printed"][planner].get(metric)
    value = values[paper["rows"].index(row)] if values else None
    return None if value is None else float(value)


def metric_table(runs: pd.DataFrame, metric: str, in_paper: bool = True) -> str:
    """One metric as a Markdown table: paper | thesis rules | fair rules | SUMO for each planner.

    Args:
        runs: one run for each row, planner and set of rules.
        metric: name of the metric.
        in_paper: the paper has such rows.

    Returns:
        The table.
    """
    lines = [["row", *(f"{planner}: paper, thesis, fair, SUMO" for planner in PLANNERS)]]
    for garage, agvs, cars in runs[["garage", "agvs", "cars"]].drop_duplicates().itertuples(index=False):
        group = runs[(runs["garage"] == garage) & (runs["agvs"] == agvs)]
        cells = [f"{garage.upper()} x {agvs}" + ("" if pd.isna(cars) else f", {cars:g} cars")]
        for planner in PLANNERS:
            own = group[group["planner"] == planner].set_index("rules")[metric]
            said = paper_value(metric, planner, garage, agvs, cars) if in_paper else None
            values = [said, *(own.get(rules) for rules in (THESIS, FAIR, SUMO))]
            cells.append(" / ".join("-" if v is None or pd.isna(v) else _short(float(v)) for v in values))
        lines.append(cells)
    widths = [max(len(line[i]) for line in lines) for i in range(len(lines[0]))]
    text = ["| " + " | ".join(c.ljust(w) for c, w in zip(line, widths, strict=True)) + " |" for line in lines]
    text.insert(1, "|" + "|".join("-" * (w + 2) for w in widths) + "|")
    return "\n".join(text) + "\n"


def _short(value: float) -> str:
    return f"{value:.0f}" if value == round(value) else f"{value:.4f}"


# --- claims -----------------------------------------------------------------------------------------------------------


def claims(runs: pd.DataFrame) -> Iterator[Finding]:
    """The thesis's three claims, under its rules and under equal ones, with what came out."""
    for rules in (THESIS, FAIR):
        own = runs[runs["rules"] == rules]
        table = own.pivot_table(index=["garage", "agvs"], columns="planner", values="throughput", sort=False)
        for garages, best, words in (
            (("map1",), ("astar", "dstar_lite"), "low density: A* and D* Lite have the highest throughput"),
            (("map2", "map3"), ("pipeline",), "high density: the pipeline has the highest throughput"),
        ):
            part = table[table.index.get_level_values("garage").isin(garages)]
            winners = part.idxmax(axis=1)
            ours = f"{int(winners.isin(best).sum())} of {len(part)} rows"
            yield Finding(f"{words} ({rules} rules)", "all rows", ours, holds=bool(winners.isin(best).all()))
        work = own[own["agvs"] > 1].pivot_table(
            index=["garage", "agvs"], columns="planner", values="nodes_expanded", sort=False
        )
        ordered = (work["pipeline"] < work["dstar_lite"]) & (work["dstar_lite"] < work["astar"])
        ours = f"{int(ordered.sum())} of {len(work)} rows"
        words = f"expansions: pipeline < D* Lite < A* from 2 AGVs on ({rules} rules)"
        yield Finding(words, "all rows", ours, holds=bool(ordered.all()))
        ratio = work["astar"].iloc[-1] / work["pipeline"].iloc[-1]
        row = "{} x {}".format(*work.index[-1])
        yield Finding(f"A*'s expansions / the pipeline's, {row} ({rules} rules)", "19 (MAP3)", f"{ratio:.1f}")
    fair = runs[runs["rules"] == FAIR]
    clean = (fair["completion"] == 1) & (fair["conflicts"] == 0)
    yield Finding(
        "every run under fair rules completes without a conflict", "", f"{int(clean.sum())} of {len(clean)}",
        holds=bool(clean.all()),
    )  # fmt: skip


def best_planners(runs: pd.DataFrame) -> Iterator[Finding]:
    """For each row the best planner over the demand seeds, and by how much it beats the default, paired by seed."""
    from analysis.measures import interval

    seeded = runs[runs["seed"].notna()]
    for garage, agvs in seeded[["garage", "agvs"]].drop_duplicates().itertuples(index=False):
        group = seeded[(seeded["garage"] == garage) & (seeded["agvs"] == agvs)]
        table = group.pivot_table(index="seed", columns="planner", values="throughput")
        best = str(table.mean().idxmax())
        rest = table.drop(columns="pipeline")
        rival = str(rest.mean().idxmax())
        lead = interval(list((table["pipeline"] - table[rival]) * 1000.0))
        yield Finding(
            f"{garage.upper()} x {agvs}: best planner; pipeline - {rival}, tasks in 1,000 steps", "",
            f"{best}; {lead.mean:+.3f}", f"{lead.low:+.3f} to {lead.high:+.3f}", lead.high >= 0,
        )  # fmt: skip


def draw(runs: pd.DataFrame, metric: str) -> Figure:
    """One metric: bars for each row and planner, the paper's and ours under either set of rules."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 3.2), layout="constrained")
    axes = figure.subplots(1, len(PLANNERS), sharey=True)
    for ax, planner in zip(axes, PLANNERS, strict=True):
        own = runs[runs["planner"] == planner]
        cells = list(own[["garage", "agvs", "cars"]].drop_duplicates().itertuples(index=False))
        for k, source in enumerate(("paper", THESIS, FAIR)):
            if source == "paper":
                heights = [paper_value(metric, planner, *cell) or 0.0 for cell in cells]
            else:
                by_cell = own[own["rules"] == source].set_index(["garage", "agvs"])[metric]
                heights = [float(by_cell.get((cell.garage, cell.agvs), 0.0)) for cell in cells]
            ax.bar([i + (k - 1) * 0.27 for i in range(len(cells))], heights, 0.25, label=source)
        ax.set_xticks(range(len(cells)), [f"{cell.garage} x {cell.agvs}" for cell in cells], rotation=45, ha="right")
        ax.set_title(planner)
        if metric in ("nodes_expanded", "heap_moves", "nodes_generated", "valid_expansions", "slot_choice_expanded"):
            ax.set_yscale("log")
    axes[0].set_ylabel(metric)
    axes[-1].legend()
    return figure

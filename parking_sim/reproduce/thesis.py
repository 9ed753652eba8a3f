"""Paper 002, the thesis on parking-lot AGVs (2025), tables 2-1 to 2-7: its planners and ours, row by row.

Each cell of a table is run under the thesis's rules, under equal ("fair") rules, and in SUMO on the thesis's grids.
What the rules are and what came out: docs/thesis.md.
"""

from __future__ import annotations

from pathlib import Path

from parking_sim.reproduce.findings import findings_table, make_folder, write_findings
from parking_sim.reproduce.thesis_claims import best_planners, claims
from parking_sim.reproduce.thesis_runs import (
    METRICS,
    ROWS,
    SUMO,
    more_cases,
    quick_cases,
    run_cases,
    seed_cases,
    table_cases,
)
from parking_sim.reproduce.thesis_tables import draw, legend, metric_table, program_table, slips_table
from sumo_nets.whole_file import whole_file, write_whole

#: Metrics of park and fetch.
MORE_METRICS = ("completion", "conflicts", "throughput", "steps", "nodes_expanded", "bound_share")


def reproduce(folder: Path, full: bool, workers: int = 2) -> None:
    """Run the tables, print them and write them with the runs, the claims and a figure for each metric.

    Args:
        folder: where ``thesis-runs.csv``, ``thesis.csv``, ``thesis.md`` and the figures go.
        full: all rows with all cars, park and fetch on every map, more AGVs, and the comparison over demand seeds;
            else MAP1, MAP2 with 40 cars, two rows under fair rules, and one in SUMO without A* and D* Lite.
        workers: processes.

    Raises:
        InputError: the folder can't be written.
    """
    make_folder(folder)
    tables = list(table_cases(ROWS) if full else quick_cases())
    seeds, more = (list(seed_cases()), list(more_cases())) if full else ([], [])
    cases = sorted([*tables, *seeds, *more], key=lambda case: case.rules == SUMO)  # what takes longest comes last
    print(f"{legend()}{len(cases)} runs in {workers} processes", flush=True)
    runs = run_cases(cases, workers, folder / "thesis-runs.csv")
    of = {case: n for n, case in enumerate(cases)}
    rows, seeded, beyond = (runs.iloc[[of[case] for case in part]] for part in (tables, seeds, more))
    text = "".join(f"{METRICS[metric]}\n\n{metric_table(rows, metric)}\n" for metric in METRICS)
    text += f"(!) contradicts the thesis's own tables; printed figures that look like slips\n\n{slips_table()}\n"
    text += f"thesis rules, beside the authors' program\n\n{program_table(rows)}\n"
    if full:
        for m in MORE_METRICS:
            text += f"park and fetch, {METRICS[m]}\n\n{metric_table(beyond, m, paper=False)}\n"
    findings = [*claims(rows), *best_planners(seeded)]
    write_findings(findings, folder, "thesis", full)
    text += findings_table(findings, full)
    write_whole(folder / "thesis.md", f"{legend()}\n{text}")
    for metric in METRICS:
        with whole_file(folder / f"thesis-{metric}.svg") as part:
            draw(rows, metric).savefig(part, metadata={"Date": None})
    print(text, end="")
    print(f"tables and figures: {folder}")

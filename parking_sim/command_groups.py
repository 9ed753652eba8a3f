"""What the console's help shows beside each command's own text: groups of commands, and an example for each command."""

from __future__ import annotations

import sys
from typing import Any

from typer.core import TyperGroup

#: What one wants to do -> command -> an example of it. Each command is in one group; the help shows them in this order.
GROUPS: dict[str, dict[str, str]] = {
    "Run a garage": {
        "demo": "parking-sim demo --cars 10",
        "run": "parking-sim run map1 --agvs 4 --seed 7 --out runs/first",
        "replay": "parking-sim replay runs/first --from 0:10:00 --to 0:20:00",
    },
    "Ask a question": {
        "size": "parking-sim size map1 --profile mall-saturday --scale 0.5 --target 'retrieval p95 < 15 min'",
        "sweep": "parking-sim sweep fleets.yaml --workers 4",
        "compare": "parking-sim compare runs/fleets:agvs=4 runs/fleets:agvs=6",
        "tune": "parking-sim tune map1 --vary control.period_s=2..10 --trials 20",
        "profiles": "parking-sim profiles mall-saturday --figure day.svg",
        "fit-profile": "parking-sim fit-profile gates.csv --slots 120 --out mine.yaml",
        "requests": "parking-sim requests gates.csv --date 2026-03-07 --out day.csv",
    },
    "Build a garage": {
        "nets": "parking-sim nets",
        "build-net": "parking-sim build-net corner.yaml",
        "trace-lanes": "parking-sim trace-lanes plan.yaml --draw plan.svg",
        "check-net": "parking-sim check-net corner.net.xml.gz",
        "draw-net": "parking-sim draw-net map1 --out map1.svg",
        "route": "parking-sim route map1 home3_3e1 slot9_2n1",
        "turns": "parking-sim turns map1 --aisle 3.5",
    },
    "Read a record": {
        "explain": "parking-sim explain runs/first",
        "rerun": "parking-sim rerun runs/first",
        "resume": "parking-sim resume runs/first",
        "columns": "parking-sim columns",
        "schema": "parking-sim schema",
    },
    "Repeat a paper": {
        "reproduce": "parking-sim reproduce thesis",
    },
    "Test a planner": {
        "check-planner": "parking-sim check-planner loaded_first.py:plan --problems 500",
    },
    "Look at the installation": {
        "doctor": "parking-sim doctor",
        "examples": "parking-sim examples --out examples",
    },
}

#: Command of ``reproduce`` -> an example of it.
PAPERS: dict[str, str] = {
    "thesis": "parking-sim reproduce thesis",
    "rrt-grid": "parking-sim reproduce rrt-grid --full",
    "binary-tree": "parking-sim reproduce binary-tree",
    "two-stage-ga": "parking-sim reproduce two-stage-ga --instances 10",
    "lg": "parking-sim reproduce lg --out runs/lg",
}


def example_of(command: str, of_reproduce: bool = False) -> str:
    """A command's example; empty for a command that is in no table."""
    if of_reproduce:
        return PAPERS.get(command, "")
    return next((examples[command] for examples in GROUPS.values() if command in examples), "")


class WithExamples(TyperGroup):
    """Commands, each with an example under its help."""

    of_reproduce = False

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """A command by its name, with the example as its last lines; None if there is none."""
        command = super().get_command(ctx, cmd_name)
        if command is not None and (example := example_of(cmd_name, self.of_reproduce)):
            command.epilog = f"\b\nExample:\n  {example}"  # \b: these lines stay as they are
        return command


class Papers(WithExamples):
    """The commands of ``reproduce``."""

    of_reproduce = True


class Grouped(WithExamples):
    """The program's commands; its help lists them by what one wants to do."""

    def invoke(self, ctx: Any) -> Any:
        """Call a command. Typer ends without a word at Ctrl-C; here it has one."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            print("interrupted", file=sys.stderr)
            raise

    def list_commands(self, ctx: Any) -> list[str]:
        """The commands in the order of their groups."""
        return [name for examples in GROUPS.values() for name in examples]

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write each group with its commands; a command's line is the first sentence of its help."""
        width = max(len(name) for name in self.commands)
        for title, examples in GROUPS.items():
            rows = [(name.ljust(width), self.commands[name].get_short_help_str(limit=200)) for name in examples]
            with formatter.section(title):
                formatter.write_dl(rows)

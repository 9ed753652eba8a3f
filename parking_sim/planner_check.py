"""The command ``check-planner``: a planner of one's own, or a built-in one, on random problems."""

from __future__ import annotations

from typing import Annotated

import typer

from sumo_nets.errors import InputError


def check_planner(
    planner: Annotated[str, typer.Argument(help="A planner's name, or file.py:function.")],
    problems: Annotated[int, typer.Option(min=1, help="How many random problems.")] = 200,
) -> None:
    """Try a planner on random problems and say what it violates."""
    from controller.planners.contract import check_planner as check
    from controller.planners.contract import random_problem
    from controller.planners.table import load_planner

    first = random_problem(0)
    try:
        load_planner(planner, first.graph, first.motion, {})
    except ValueError as error:
        raise InputError(f"check-planner: {error}") from None
    wrong = 0
    for finding in check(lambda graph, motion: load_planner(planner, graph, motion, {}), problems):
        wrong += 1
        for reason in finding.reasons:
            print(f"problem {finding.number}: {reason}")
    print(f"{planner}: {problems - wrong} of {problems} answers keep to the contract")
    raise typer.Exit(1 if wrong else 0)

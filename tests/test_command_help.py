"""The console's help: each command is in one group, and has an example that can be typed."""

from __future__ import annotations

import shlex
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer

from parking_sim.cli import app
from parking_sim.command_groups import GROUPS

PROGRAM: Any = typer.main.get_command(app)


def leaves(group: Any, words: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Every command with the words that call it."""
    context = typer.Context(group, info_name="parking-sim")
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        yield (*words, name), command
        if hasattr(command, "commands"):
            yield from leaves(command, (*words, name))


COMMANDS = dict(leaves(PROGRAM))


def example(command: Any) -> str:
    return str(command.epilog or "").rpartition("Example:\n")[2].strip()


def parse(words: list[str]) -> tuple[str, ...]:
    """Parse a command line down to the command that would run, and give that command's words."""
    group, context, called = PROGRAM, typer.Context(PROGRAM, info_name="parking-sim"), ()
    while hasattr(group, "commands"):
        name, group, words = group.resolve_command(context, words)
        called = (*called, name)
        if hasattr(group, "commands"):
            context = typer.Context(group, info_name=name, parent=context)
    group.make_context(called[-1], words, parent=context)
    return called


def test_each_command_is_in_one_group() -> None:
    grouped = [name for commands in GROUPS.values() for name in commands]
    assert sorted(grouped) == sorted(PROGRAM.commands)


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_each_example_calls_its_command(words: tuple[str, ...]) -> None:
    program, *given = shlex.split(example(COMMANDS[words]))
    assert program == "parking-sim"
    called = parse(given)
    assert called[: len(words)] == words


@pytest.mark.parametrize("given", [["run", "map1", "--no-such"], ["size", "map1"], ["replay"]])
def test_an_example_with_a_slip_would_not_pass(given: list[str]) -> None:
    with pytest.raises(typer.BadParameter.__bases__[0]):
        parse(given)


def test_the_docs_show_each_example() -> None:
    code = (Path(__file__).parent.parent / "docs" / "reference.py").read_text(encoding="utf-8")
    module: dict[str, Any] = {"__name__": "reference"}
    exec(compile(code, "reference.py", "exec"), module)
    page = module["pages"]()["commands"]
    assert all(f"  {example(command)}\n" in page for command in COMMANDS.values())


def test_the_help_names_all_groups_and_loads_nothing_heavy() -> None:
    code = (
        "import sys; from parking_sim import cli\n"
        "try: cli.main(['--help'])\n"
        "except SystemExit: print(*sorted(sys.modules), file=sys.stderr)"
    )
    begin = time.perf_counter()
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert time.perf_counter() - begin < 5  # a loaded machine; 0.3 s where nothing else runs
    assert not {"numba", "numpy", "pandas", "pydantic", "rich"} & set(done.stderr.split())
    titles = [line.rstrip(":") for line in done.stdout.splitlines() if line.endswith(":") and not line.startswith(" ")]
    assert titles == ["Options", *GROUPS]


def test_the_examples_are_listed_and_copied(tmp_path: Any, capfd: Any, monkeypatch: Any) -> None:
    from parking_sim.cli import main

    monkeypatch.chdir(tmp_path)
    for command, code in ((["examples"], 0), (["examples", "--out", "mine"], 0), (["examples", "--out", "mine"], 2)):
        with pytest.raises(SystemExit) as ended:
            main(command)
        assert ended.value.code == code
    out, err = capfd.readouterr()
    names = {"bursts.yaml", "corner.yaml", "fleets.yaml", "gate_log.csv", "loaded_first.py", "own_planner.py"}
    assert names <= {path.name for path in (tmp_path / "mine").iterdir()}
    assert len(out.splitlines()) == 2 * len(list((tmp_path / "mine").iterdir()))
    assert err == "error: --out: mine: holds bursts.yaml already; give another folder\n"

"""Mutation tests: faults planted in the core, one at a time, and whether the tests see them.

    python benchmarks/mutants.py [--each 40] [--seed 0] [--module controller/executor.py] [--csv FILE]

A mutant is a module with one change in its syntax tree: a comparison, an arithmetic or Boolean operator, a constant, a
negated condition, a statement or a returned value left out. Docstrings, messages and annotations are left alone. Each
mutant is imported in a forked process in place of its module, and the module's tests are run until one fails. Tests
that take more than five times as long as without a mutant are stopped: the mutant is dead, and counted as timed out as
well. For each module ``--each`` mutants are drawn; survivors are printed with their lines. The share killed has
Wilson's interval of 95 %. Compiled kernels are left out, but for those of the footprint check, which run uncompiled.
"""

from __future__ import annotations

import argparse
import ast
import copy
import importlib.abc
import importlib.util
import math
import os
import random
import signal
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import date
from importlib.machinery import ModuleSpec
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Any

import pandas as pd

ROOT = Path(__file__).parent.parent
#: Module -> its tests, quick ones first.
MODULES: dict[str, tuple[str, ...]] = {
    "controller/executor.py": (
        "test_executor.py", "test_guests.py", "test_replanning.py", "test_garage.py",
        "test_executor_against_planners.py",
    ),
    "controller/visits.py": ("test_executor.py", "test_guests.py", "test_executor_against_planners.py"),
    "controller/garage.py": ("test_garage.py", "test_charging.py", "test_turned_away.py"),
    "controller/acs.py": (
        "test_garage.py", "test_charging.py", "test_places.py", "test_faults.py",
    ),
    "controller/claims.py": (
        "test_claims.py", "test_places.py", "test_garage.py", "test_charging.py", "test_sumo_plant_customers.py",
    ),
    "controller/deadlock/waits.py": ("test_deadlock.py", "test_deadlock_cases.py", "test_holds.py"),
    "controller/deadlock/ladder.py": ("test_deadlock.py", "test_deadlock_cases.py", "test_deadlocks_explained.py"),
    "controller/deadlock/cut_off.py": ("test_deadlock.py", "test_deadlock_cases.py", "test_faults.py"),
    "parking_sim/footprint.py": ("test_footprint.py", "test_clearance.py"),
    "analysis/witness.py": ("test_witness.py",),
}  # fmt: skip
#: Modules whose kernels are mutated, too, and run uncompiled.
UNCOMPILED = ("parking_sim/footprint.py",)
#: What is imported once, before any process is forked.
WARM = (
    "numpy", "pandas", "numba", "networkx", "scipy.spatial", "duckdb", "pydantic", "hypothesis", "pytest", "shapely",
)  # fmt: skip
#: Tests run for ever when they take this many times as long as without a mutant, and seconds at least.
LIMIT_TIMES, LIMIT_S = 5.0, 60.0

_COMPARE = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
            ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Is: ast.IsNot, ast.IsNot: ast.Is}  # fmt: skip
_ARITHMETIC = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult,
               ast.BitOr: ast.BitAnd, ast.BitAnd: ast.BitOr, ast.Mod: ast.Mult}  # fmt: skip


@dataclass(frozen=True)
class Mutant:
    """A module with one change: its line, and what was changed into what."""

    line: int
    words: str
    source: str


def mutants(source: str, uncompiled: bool) -> Iterator[Mutant]:
    """All mutants of a module; those of its kernels only where these are run ``uncompiled``."""
    tree = ast.parse(source)
    for node, parent in list(_nodes(tree, uncompiled)):
        for change in _changes(node, parent):
            before = ast.unparse(node)
            undo = change()
            after = ast.unparse(node).splitlines()[0]
            after = "left out" if after == before.splitlines()[0] else after
            text = ast.unparse(tree)
            undo()
            yield Mutant(getattr(node, "lineno", 0), f"{before.splitlines()[0][:70]}  ->  {after[:70]}", text)


def _nodes(tree: ast.AST, kernels: bool, parent: ast.AST | None = None) -> Iterator[tuple[ast.AST, ast.AST | None]]:
    """Nodes that may be changed: neither annotations, imports, decorators, messages nor what runs for types alone."""
    if isinstance(tree, ast.Import | ast.ImportFrom | ast.JoinedStr | ast.Raise):
        return
    if isinstance(tree, ast.AnnAssign) and not tree.value:
        return
    if isinstance(tree, ast.If) and ast.unparse(tree.test) == "TYPE_CHECKING":
        return
    if is_kernel(tree) and not kernels:
        return
    yield tree, parent
    for name, value in ast.iter_fields(tree):
        if name in ("annotation", "returns", "decorator_list") or (name == "args" and isinstance(value, ast.arguments)):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and not _is_text(child):
                yield from _nodes(child, kernels, tree)


def _is_text(node: ast.AST) -> bool:
    if isinstance(node, ast.Expr):
        return isinstance(node.value, ast.Constant)
    return isinstance(node, ast.Constant) and isinstance(node.value, str)


def is_kernel(node: ast.AST) -> bool:
    """Whether a function is compiled."""
    return isinstance(node, ast.FunctionDef) and any(
        ast.unparse(mark).startswith(("kernel", "njit")) for mark in node.decorator_list
    )


def _changes(node: ast.AST, parent: ast.AST | None) -> Iterator[Any]:
    """Functions that change a node in place and return what undoes it."""
    if isinstance(node, ast.Compare):
        for k, op in enumerate(node.ops):
            if type(op) in _COMPARE:
                yield lambda k=k, op=op: _put(node.ops, k, _COMPARE[type(op)](), op)
    elif isinstance(node, ast.BinOp | ast.AugAssign) and type(node.op) in _ARITHMETIC:
        yield lambda op=node.op: _set(node, "op", _ARITHMETIC[type(op)](), op)
    elif isinstance(node, ast.BoolOp):
        other = ast.Or() if isinstance(node.op, ast.And) else ast.And()
        yield lambda op=node.op: _set(node, "op", other, op)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        yield lambda x=node.operand: _set(node, "operand", ast.UnaryOp(ast.Not(), copy.deepcopy(x)), x)
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield lambda v=node.value: _set(node, "value", not v, v)
    elif isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        yield lambda v=node.value: _set(node, "value", v + 1, v)
    elif isinstance(node, ast.If | ast.While | ast.IfExp):
        yield lambda t=node.test: _set(node, "test", ast.UnaryOp(ast.Not(), copy.deepcopy(t)), t)
    elif isinstance(node, ast.Return) and node.value is not None and not isinstance(node.value, ast.Constant):
        yield lambda v=node.value: _set(node, "value", ast.Constant(None), v)
    if isinstance(node, ast.Expr | ast.AugAssign | ast.Delete) and parent is not None:
        for block in ("body", "orelse", "finalbody"):
            rows = getattr(parent, block, None)
            if isinstance(rows, list) and node in rows:
                k = rows.index(node)
                yield lambda rows=rows, k=k: _put(rows, k, ast.Pass(), node)


def _put(rows: list[Any], k: int, new: Any, old: Any) -> Any:
    rows[k] = new
    return lambda: rows.__setitem__(k, old)


def _set(node: ast.AST, name: str, new: Any, old: Any) -> Any:
    setattr(node, name, ast.fix_missing_locations(new) if isinstance(new, ast.AST) else new)
    return lambda: setattr(node, name, old)


class _Planted(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Gives a mutant in place of its module; compiled kernels are those of the module itself, or run uncompiled."""

    def __init__(self, module: str, source: str) -> None:
        self.name, self.path = module.removesuffix(".py").replace("/", "."), ROOT / module
        self.source, self.uncompiled = source, module in UNCOMPILED

    def find_spec(self, fullname: str, path: object, target: object = None) -> ModuleSpec | None:
        return importlib.util.spec_from_loader(fullname, self, origin=str(self.path)) if fullname == self.name else None

    def exec_module(self, module: ModuleType) -> None:
        module.__file__ = str(self.path)
        tree = ast.parse(self.source)
        if self.uncompiled:
            for node in ast.walk(tree):
                if isinstance(node, ast.FunctionDef) and is_kernel(node):
                    node.decorator_list = []
        elif any(map(is_kernel, tree.body)):
            exec(compile(self.path.read_text(encoding="utf-8"), str(self.path), "exec"), module.__dict__)
            tree.body = [node for node in tree.body if not is_kernel(node)]
        exec(compile(ast.fix_missing_locations(tree), str(self.path), "exec"), module.__dict__)


def outcome(module: str, source: str, limit_s: float) -> str:
    """What the tests of a module make of a mutant: ``killed``, ``survived``, or ``timed out`` after so many seconds."""
    child = os.fork()
    if child == 0:
        os.setsid()
        for handle in (1, 2):
            os.dup2(os.open(os.devnull, os.O_WRONLY), handle)
        os.chdir(ROOT)
        sys.meta_path.insert(0, _Planted(module, source))
        import pytest

        tests = [f"tests/{name}" for name in MODULES[module]]
        code = pytest.main(["-x", "-q", "-n", "0", "-p", "no:cacheprovider", "--no-header", *tests])
        os._exit(1 if code else 0)
    end = time.monotonic() + limit_s
    while time.monotonic() < end:
        pid, status = os.waitpid(child, os.WNOHANG)
        if pid:
            return "killed" if os.waitstatus_to_exitcode(status) else "survived"
        time.sleep(0.02)
    os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return "timed out"


def score(module: str, each: int, seed: int) -> tuple[dict[str, Any], list[Mutant]]:
    """A module's row, and the mutants that survived."""
    source = (ROOT / module).read_text(encoding="utf-8")
    begin = time.monotonic()
    assert outcome(module, source, math.inf) == "survived", f"the tests of {module} fail without a mutant"
    limit_s = max(LIMIT_S, LIMIT_TIMES * (time.monotonic() - begin))
    every = [m for m in mutants(source, module in UNCOMPILED) if m.source != ast.unparse(ast.parse(source))]
    drawn = sorted(random.Random(f"{module} {seed}").sample(every, min(each, len(every))), key=lambda m: m.line)
    came = [outcome(module, mutant.source, limit_s) for mutant in drawn]
    left = [mutant for mutant, word in zip(drawn, came, strict=True) if word == "survived"]
    least, most = wilson(len(drawn) - len(left), len(drawn))
    row = {"module": module, "mutants": len(every), "tried": len(drawn), "killed": len(drawn) - len(left)}
    return {**row, "timed_out": came.count("timed out"), "least": round(least, 3), "most": round(most, 3)}, left


def wilson(hits: int, tries: int) -> tuple[float, float]:
    """Bounds of a share in 95 % of samples (Wilson 1927)."""
    z, share = 1.96, hits / tries
    middle = share + z * z / (2 * tries)
    half = z * math.sqrt(share * (1 - share) / tries + z * z / (4 * tries * tries))
    return (middle - half) / (1 + z * z / tries), (middle + half) / (1 + z * z / tries)


def main() -> int:
    """Score the modules, print survivors and the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--each", type=int, default=40)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--module", choices=tuple(MODULES), action="append")
    parser.add_argument("--csv", type=Path, help="add a row for each module")
    given = parser.parse_args()
    for name in WARM:
        importlib.import_module(name)
    stamp = {"version": version("parking-sim"), "date": date.today().isoformat()}
    rows: list[dict[str, Any]] = []
    for module in given.module or MODULES:
        row, left = score(module, given.each, given.seed)
        command = f"python benchmarks/mutants.py --each {given.each} --seed {given.seed} --module {module}"
        rows.append({**row, **stamp, "command": command})
        print(row, flush=True)
        for mutant in left:
            print(f"    line {mutant.line}: {mutant.words}", flush=True)
        if given.csv:
            pd.DataFrame(rows[-1:]).to_csv(given.csv, mode="a", header=not given.csv.exists(), index=False)
    tried, killed = sum(row["tried"] for row in rows), sum(row["killed"] for row in rows)
    print(f"{killed} of {tried} killed, {killed / tried:.1%}")
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Remake every table of the README and the docs that comes from runs of this program.

    python benchmarks/remake.py                    all sets of runs, then the tables in README.md and docs/
    python benchmarks/remake.py whole,saturation   these sets only; --list names them
    python benchmarks/remake.py --docs             only the tables, from the results that are there

The runs of a set are rows of ``benchmarks/results/SET.csv``, each with the version, the commit and the date that made
it. A row is written as soon as its run has ended, and rows of the present code are not made again: a killed process
goes on where it stopped, and the same command after a change of the code makes all rows anew. A table stands in a
document between ``<!-- table: NAME -->`` and ``<!-- /table -->``; nothing between these is typed by hand, and a test
compares it with the results. Sets and tables are defined in the ``*_tables.py`` beside it; ``figures.py`` gathers them.
"""

from __future__ import annotations

import argparse
import multiprocessing
import re
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from datetime import date
from importlib.metadata import version
from pathlib import Path

import pandas as pd

sys.path.insert(0, str(Path(__file__).parent))
from figures import SETS, TABLES, Row, RunSet

from parking_sim.versions import code_version

ROOT = Path(__file__).parent.parent
RESULTS = ROOT / "benchmarks" / "results"
DOCUMENTS = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
#: Columns that say what made a row.
STAMP = ("version", "commit", "date", "code")

_TABLE = re.compile(r"(<!-- table: ([\w-]+) -->\n).*?(<!-- /table -->)", re.DOTALL)


def remake(name: str, folder: Path, workers: int, sets: Mapping[str, RunSet] = SETS) -> Iterator[Row]:
    """Make the rows of a set that are not there, or not of the present code.

    Args:
        name: the set.
        folder: where its results are.
        workers: processes; 1 makes the runs in this one.
        sets: all sets.

    Yields:
        Each new row, after it has been written.
    """
    path = folder / f"{name}.csv"
    wanted = {_key(case): case for case in sets[name].cases}
    keys = list(sets[name].cases[0])
    found = {_key({key: row[key] for key in keys}): row for row in read_results(path)}
    stamp = {"version": version("parking-sim"), "commit": _commit(), "code": code_version()}
    todo = [case for key, case in wanted.items() if found.get(key, {}).get("code") != stamp["code"]]
    for case, figures in _made(sets[name].run, todo, workers):
        done: Row = {**case, **figures, **stamp, "date": date.today().isoformat()}
        found[_key(case)] = done
        _write(pd.DataFrame([found[key] for key in wanted if key in found]), path)
        yield done


def read_results(path: Path) -> list[Row]:
    """The rows of a set; none if it was never made."""
    if not path.is_file():
        return []
    texts = ("commit", "code", "complaints", "target", "grid", "answer", "reason")
    table = pd.read_csv(path, dtype=dict.fromkeys(texts, str)).fillna(dict.fromkeys(texts, ""))
    return [{str(key): value for key, value in row.items()} for row in table.to_dict("records")]


def with_tables(text: str, folder: Path) -> str:
    """A document with its tables as the results have them; a table without results is left empty.

    Args:
        text: the document.
        folder: where the results are.

    Returns:
        The document.
    """
    return _TABLE.sub(lambda found: found[1] + table_text(found[2], folder) + found[3], text)


def table_text(name: str, folder: Path) -> str:
    """A table in Markdown, with a line that says what made it."""
    table = TABLES[name]
    rows = read_results(folder / f"{table.runs}.csv")
    body = table.show(rows) if rows else []
    if not body:
        return ""
    made = dict.fromkeys(f"{row['version']}, commit {row['commit']}, {row['date']}" for row in rows)
    return "\n".join(
        ["", *body, "", f"*Made with {'; '.join(made)}: `python benchmarks/remake.py {table.runs}`*", "", ""]
    )


def _key(case: Row) -> tuple[str, ...]:
    """What tells a case from others, whether it comes from the program or from a file."""
    return tuple(f"{value:g}" if isinstance(value, float) else str(value) for value in case.values())


def _made(run: Callable[[Row], Row], todo: Sequence[Row], workers: int) -> Iterator[tuple[Row, Row]]:
    """Each case with its figures, as they come."""
    if workers == 1:
        yield from ((case, run(case)) for case in todo)
        return
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as pool:
        futures = {pool.submit(run, case): case for case in todo}
        yield from ((futures[future], future.result()) for future in as_completed(futures))


def _commit() -> str:
    """The commit that is checked out, with a + if what runs differs from it: all files but results and documents."""
    head = _git("rev-parse", "--short=7", "HEAD")
    changed = _git("status", "--porcelain", "--untracked-files=no", "--", ".", ":!benchmarks/results", ":!*.md")
    return f"{head or 'unknown'}{'+' if changed else ''}"


def _git(*words: str) -> str:
    return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=False).stdout.strip()


def _write(rows: pd.DataFrame, path: Path) -> None:
    """All at once, so that a killed process leaves the rows before or the rows after."""
    path.parent.mkdir(exist_ok=True)
    fresh = path.with_suffix(".new")
    rows.to_csv(fresh, index=False, float_format="%.6g")
    fresh.replace(path)


def write_documents() -> None:
    """Bring the tables of all documents up to the results."""
    for path in DOCUMENTS:
        old = path.read_text(encoding="utf-8")
        if (new := with_tables(old, RESULTS)) != old:
            path.write_text(new, encoding="utf-8")
            print(f"tables of {path.relative_to(ROOT)}")


def main() -> None:
    """Make what is asked for and print each row."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("sets", nargs="?", type=lambda text: text.split(","), default=list(SETS))
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--docs", action="store_true")
    parser.add_argument("--list", action="store_true")
    given = parser.parse_args()
    if unknown := set(given.sets) - set(SETS):
        parser.error(f"{', '.join(sorted(unknown))}: give some of {', '.join(SETS)}")
    if given.list:
        for name in SETS:
            print(f"{name}: {len(SETS[name].cases)} runs, {SETS[name].words}")
        return
    for name in () if given.docs else given.sets:
        for row in remake(name, RESULTS, given.workers):
            print(name, " ".join(f"{key}={value}" for key, value in row.items() if key not in STAMP), flush=True)
    write_documents()


if __name__ == "__main__":
    main()

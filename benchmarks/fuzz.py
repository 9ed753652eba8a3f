"""Mutated files for every reader, called in one process: taken, or refused in few lines; nothing else.

    python benchmarks/fuzz.py --files 10000 --csv benchmarks/results/fuzz.csv
    python benchmarks/fuzz.py --readers net sweep --files 500 --seed 7 --keep finds
    python benchmarks/fuzz.py --coverage --files 200          guided by the lines that are reached, several times slower

Each file is one of the repository's own with a few changes: bytes flipped, cut, spliced with another file, lines
doubled, odd scalars in place of numbers and words, numbers made huge, parts of a document swapped, unfolded or put into
each other. A mutant that brings a reader to a complaint not heard before is kept, and mutated further: so the fuzzing
goes on where it has come to. With ``--coverage`` so is one that reaches a line not reached before. Each call has ten
seconds, with ``--coverage`` a minute; what it writes outside its folder is seen by an audit hook, and the memory of the
process is looked at. Files that were found are written to ``--keep``. Exit code 1 if anything was.
"""

from __future__ import annotations

import argparse
import random
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import date
from importlib.metadata import version
from pathlib import Path
from types import FrameType
from typing import Any

import pandas as pd
from fuzz_files import mutated
from fuzz_readers import READERS, Reader

from sumo_nets.errors import InputError

#: Seconds of a call, megabytes that the process may gain, and characters and lines of a refusal.
LIMIT_S, MOST_MB, LONGEST, MOST_LINES = 10, 500, 4200, 21
#: Mutants kept as seeds, and the share of files made of the repository's own.
MOST_KEPT, OWN = 400, 0.6
#: Events of the interpreter that change files, and which of their arguments name them.
_CHANGES = {"os.remove": 1, "os.rename": 2, "os.mkdir": 1, "os.rmdir": 1, "os.link": 2, "os.symlink": 2,
            "os.truncate": 1, "shutil.rmtree": 1, "os.chmod": 1, "subprocess.Popen": 1, "os.system": 1}  # fmt: skip


#: Where the program's own files are.
_ROOT = str(Path(__file__).parent.parent)


class _HangError(BaseException):
    """A call took too long. No reader catches it."""


@dataclass
class Tally:
    """What came of the files of one reader."""

    counts: Counter[str] = field(default_factory=Counter)
    longest_s: float = 0.0
    gained_mb: float = 0.0
    finds: list[str] = field(default_factory=list)


class Watch:
    """Sees what is written outside a folder, while it is on."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._on, self.seen = str(folder), False, list[str]()
        sys.addaudithook(self._look)

    def call(self, action: Callable[[], object]) -> list[str]:
        """Do something; what it wrote outside the folder."""
        self.seen, self._on = [], True
        try:
            action()
        finally:
            self._on = False
        return self.seen

    def _look(self, event: str, arguments: tuple[Any, ...]) -> None:
        if not self._on:
            return
        if event == "open":
            path, mode, _flags = arguments
            names = [path] if isinstance(mode, str) and set(mode) & set("wax+") else []
        else:
            names = list(arguments[: _CHANGES.get(event, 0)])
        self.seen += [f"{event} {name}" for name in names if not str(name).startswith(self._folder)]


class Coverage:
    """Lines of the program that have been reached, if they are looked at.

    Attributes:
        lines: file and line of each.
        grew: whether the last call reached a new one.
        limit_s: seconds that a call may take.
    """

    def __init__(self, on: bool) -> None:
        self._on, self.lines, self.grew = on, set[tuple[str, int]](), False
        self.limit_s = 6 * LIMIT_S if on else LIMIT_S

    def call(self, action: Callable[[], object]) -> None:
        """Do something, and look at the lines that it reaches."""
        before = len(self.lines)
        if self._on:
            sys.settrace(self._enter)
        try:
            action()
        finally:
            sys.settrace(None)
            self.grew = len(self.lines) > before

    def _enter(self, frame: FrameType, _event: str, _argument: object) -> Any:
        name = frame.f_code.co_filename
        return self._line if name.startswith(_ROOT) and "site-packages" not in name else None

    def _line(self, frame: FrameType, event: str, _argument: object) -> Any:
        if event == "line":
            self.lines.add((frame.f_code.co_filename, frame.f_lineno))
        return self._line


def peak_mb() -> float:
    """The most memory that the process has had."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1000


def outcome(reader: Reader, folder: Path, watch: Watch, coverage: Coverage) -> tuple[str, str]:
    """What comes of a file: taken, refused, long, hang, write or traceback; and the words."""
    signal.alarm(coverage.limit_s)
    try:
        written = watch.call(lambda: coverage.call(lambda: reader.read(folder)))
    except InputError as error:
        said = str(error)
        lines = said.split("\n")
        fine = len(lines) <= MOST_LINES and all(line.strip() and len(line) <= LONGEST for line in lines)
        return ("refused" if fine and "Traceback" not in said else "long"), said
    except _HangError:
        return "hang", "".join(traceback.format_exc()[-3000:])
    except Exception:
        return "traceback", traceback.format_exc()
    finally:
        signal.alarm(0)
    return ("write", "\n".join(written)) if written else ("taken", "")


def fuzz(
    reader: Reader, files: int, seed: int, keep: Path | None, folder: Path, watch: Watch, coverage: Coverage
) -> Tally:
    """Read so many mutants of a reader's files.

    Args:
        reader: what reads.
        files: how many.
        seed: what draws the mutants.
        keep: folder for files that were found.
        folder: where mutants lie while they are read.
        watch: sees what is written elsewhere.
        coverage: sees which lines are reached.
    """
    rng = random.Random(f"{reader.name} {seed}")
    seeds = list(reader.seeds())
    own, heard, tally = len(seeds), set[str](), Tally()
    for number in range(files):
        good = rng.choice(seeds[:own] if rng.random() < OWN else seeds)
        name = rng.choice(sorted(good))
        mutant = {**good, name: mutated(name, good[name], list(rng.choice(seeds).values()), rng)}
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        for file, content in mutant.items():
            (folder / file).write_bytes(content)
        before, begin = peak_mb(), time.perf_counter()
        result, words = outcome(reader, folder, watch, coverage)
        tally.longest_s = max(tally.longest_s, time.perf_counter() - begin)
        tally.gained_mb = max(tally.gained_mb, peak_mb() - before)
        if peak_mb() - before > MOST_MB:
            result = "memory"
        tally.counts[result] += 1
        shape = re.sub(r"'[^']*'|\"[^\"]*\"|-?\d[\d.e+-]*", "#", words.replace(str(folder), ""))[:400]
        if result not in ("taken", "refused"):
            shape = words.strip().split("\n")[-1][:80] + " @ " + " ".join(re.findall(r"line \d+, in \w+", words)[-2:])
            if shape not in heard:
                tally.finds.append(f"{reader.name} {number}: {result}: {words[-1500:]}")
                if keep:
                    shutil.copytree(folder, keep / f"{reader.name}-{seed}-{number}", dirs_exist_ok=True)
        elif (shape not in heard or coverage.grew) and sum(map(len, mutant.values())) < 200_000:
            seeds.append(mutant)
            if len(seeds) > own + MOST_KEPT:
                seeds.pop(rng.randrange(own, len(seeds)))
        heard.add(shape)
    return tally


def _row(reader: Reader, tally: Tally, command: str) -> dict[str, Any]:
    counts = tally.counts
    return {
        "reader": reader.name,
        "files": counts.total(),
        "taken": counts["taken"],
        "refused": counts["refused"],
        "tracebacks": counts["traceback"],
        "hangs": counts["hang"],
        "long_words": counts["long"],
        "memory": counts["memory"],
        "writes_outside": counts["write"],
        "longest_s": round(tally.longest_s, 2),
        "most_mb_gained": round(tally.gained_mb),
        "version": version("parking-sim"),
        "date": date.today().isoformat(),
        "command": command,
    }


def main() -> int:
    """Fuzz readers; the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--readers", nargs="*", choices=sorted(READERS), default=sorted(READERS))
    parser.add_argument("--files", type=int, default=500, help="mutated files for each reader")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--coverage", action="store_true", help="keep what reaches new lines, too")
    parser.add_argument("--keep", type=Path, help="folder for files that were found")
    parser.add_argument("--csv", type=Path, help="add a row for each reader")
    given = parser.parse_args()

    def hang(*_: object) -> None:
        raise _HangError

    signal.signal(signal.SIGALRM, hang)
    warnings.simplefilter("ignore")
    found = 0
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "files"
        watch = Watch(folder)
        for name in given.readers:
            coverage = Coverage(given.coverage)
            tally = fuzz(READERS[name], given.files, given.seed, given.keep, folder, watch, coverage)
            lines = f", {len(coverage.lines)} lines" if given.coverage else ""
            print(name, dict(tally.counts), f"{tally.longest_s:.2f} s, {tally.gained_mb:.0f} MB{lines}", flush=True)
            for find in tally.finds:
                print("   ", find.replace("\n", "\n    "), flush=True)
            found += len(tally.finds)
            if given.csv:
                command = f"python benchmarks/fuzz.py --readers {name} --files {given.files} --seed {given.seed}"
                command += " --coverage" if given.coverage else ""
                row = pd.DataFrame([_row(READERS[name], tally, command)])
                row.to_csv(given.csv, mode="a", header=not given.csv.exists(), index=False)
    return 1 if found else 0


if __name__ == "__main__":
    raise SystemExit(main())

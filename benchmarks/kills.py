"""Commands killed at random moments: what they leave is read or declined in one line, and what goes on ends equal.

    python benchmarks/kills.py [--kills 200] [--seed 0] [--csv FILE]

Each kill starts a command (``run`` in ticks and in SUMO, ``resume``, ``rerun``, ``replay``, ``sweep`` or ``size``) in a
process of its own. It sends SIGKILL to it and to all processes that it started, after a random part of the time that
the command takes undisturbed. Then each command that reads has to read the folder, or to say in one line what to do;
and going on (``resume``, or the same command again) has to end in the digests of the undisturbed command. Exit code 1
if not.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from datetime import date
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pandas as pd

from analysis.run_files import RUN_FILE, did_not_end
from parking_sim.cli import main as command_line

TICKS = """
garage: map1_thesis
agvs: 4
plant: discrete
workload: {kind: poisson, arrivals_per_h: 20, dwell_median_min: 15, initial_occupancy: 0.4, duration_min: 40}
faults: {travel_noise: 0.1, stop: {per_h: 4}, blocked: {per_h: 4}}
"""
SUMO = "{garage: map1, agvs: 3, plant: sumo, duration_s: 500, workload: {kind: park_exit, cars: 6}}"
SWEEP = "{base: ticks.yaml, grid: {agvs: [2, 3]}, seeds: [1]}"
COMMANDS = ("run", "run in SUMO", "resume", "rerun", "replay", "sweep", "size")
#: How often each is drawn: those that start processes of their own take long.
WEIGHTS = (12, 5, 9, 6, 6, 2, 1)


@dataclass(frozen=True)
class Ended:
    """How a command ended: its exit code (negative: killed by that signal), its words on stderr, and its time."""

    code: int
    err: str
    seconds: float


def call(folder: Path, words: tuple[str, ...], kill_after_s: float = 1e9) -> Ended:
    """Have a forked process run a command in a folder, and kill it with its own children after some seconds."""
    said = folder / "said.txt"
    began = time.perf_counter()
    child = os.fork()
    if child == 0:
        os.setsid()
        os.chdir(folder)
        handle = os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(handle, 2)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        try:
            command_line(words)
        except SystemExit as end:
            os._exit(int(end.code or 0))
        except BaseException as error:
            os.write(2, f"Traceback: {type(error).__name__}: {error}".encode())
            os._exit(70)
    while True:
        pid, status = os.waitpid(child, os.WNOHANG)
        spent = time.perf_counter() - began
        if pid:
            break
        if spent >= kill_after_s:
            with suppress(ProcessLookupError):  # it has no group of its own yet
                os.killpg(child, signal.SIGKILL)
            os.kill(child, signal.SIGKILL)
            _, status = os.waitpid(child, 0)
            break
        time.sleep(0.001)
    return Ended(os.waitstatus_to_exitcode(status), said.read_text(errors="replace") if said.exists() else "", spent)


class Trials:
    """Trials in a folder, each beside an undisturbed run of the same command."""

    def __init__(self, base: Path) -> None:
        """Make each command's undisturbed result."""
        self.base = base
        for name, text in (("ticks.yaml", TICKS), ("sumo.yaml", SUMO), ("sweep.yaml", SWEEP)):
            (base / name).write_text(text, encoding="utf-8")
        for words in (("run", str(base / "ticks.yaml"), "--out", str(base / "warm")), ("replay", str(base / "warm"))):
            with suppress(SystemExit):  # here, so that each forked process has all that it needs in memory
                command_line(words)
        self.seconds: dict[str, float] = {}
        self.wanted: dict[str, Any] = {}
        for name in COMMANDS:
            out = base / f"whole {name}".replace(" ", "-")
            self._prepare(name, out)
            ended = self._do(name, out)
            assert ended.code in (0, 1), (name, ended)
            self.seconds[name], self.wanted[name] = ended.seconds, self._result(name, out)

    def trial(self, name: str, part: float) -> str:
        """Kill a command after a part of its time; what is wrong afterwards, "" if nothing is."""
        out = self.base / "trial"
        shutil.rmtree(out, ignore_errors=True)
        self._prepare(name, out)
        ended = self._do(name, out, part * self.seconds[name])
        if ended.code not in (0, 1, -signal.SIGKILL):
            return f"ended with {ended}"
        return self._unreadable(name, out) or self._goes_on(name, out)

    def _prepare(self, name: str, out: Path) -> None:
        """What a command needs: a run that was killed, or one that has ended."""
        if name == "resume":
            half = self.base / "half"
            while not did_not_end(half):
                shutil.rmtree(half, ignore_errors=True)
                self._do("run", half, 0.6 * self.seconds["run"])
            shutil.copytree(half, out)
        elif name == "replay":
            shutil.copytree(self.base / "whole-run", out)

    def _do(self, name: str, out: Path, kill_after_s: float = 1e9) -> Ended:
        words: dict[str, tuple[str, ...]] = {
            "run": ("run", "ticks.yaml", "--out", str(out), "-q", "--no-report"),
            "run in SUMO": ("run", "sumo.yaml", "--out", str(out), "-q"),
            "resume": ("resume", str(out), "-q", "--no-report"),
            "rerun": ("rerun", str(self.base / "whole-run"), "--out", str(out), "-q"),
            "replay": ("replay", str(out)),
            "sweep": ("sweep", "sweep.yaml", "--out", str(out), "-q", "--workers", "1", "--no-report"),
            "size": ("size", "ticks.yaml", "--target", "retrieval mean < 4 min", "--out", str(out), "-q",
                     "--workers", "1", "--max-agvs", "2", "--max-seeds", "3", "--no-report"),
        }  # fmt: skip
        return call(self.base, words[name], kill_after_s)

    def _result(self, name: str, out: Path) -> Any:
        """What has to be equal."""
        if name == "sweep":
            return sorted(json.loads(path.read_text())["digest"]["events"] for path in out.glob("runs/*/run.json"))
        if name == "size":
            return json.loads((out / "sizing.json").read_text())
        return json.loads((out / RUN_FILE).read_text())["digest"], name != "replay" or (out / "replay.html").is_file()

    def _unreadable(self, name: str, out: Path) -> str:
        """A command that neither reads the folder nor declines it in one line."""
        if name in ("sweep", "size"):
            readers: tuple[tuple[str, ...], ...] = (("compare", f"{out}:agvs=2", f"{out}:agvs=3"),)
        else:
            readers = ("explain", str(out)), ("replay", str(out)), ("compare", str(out), str(out)), ("rerun", str(out))
            readers = readers[: 2 if name == "run in SUMO" else 3]
        for words in readers:
            ended = call(self.base, words)
            fine = ended.code in (0, 1) or (ended.code == 2 and ended.err.count("\n") == 1 and len(ended.err) < 400)
            if not fine:
                return f"{words[0]}: {ended}"
        return ""

    def _goes_on(self, name: str, out: Path) -> str:
        """Go on in the way that the program names."""
        words = ("resume", str(out), "-q", "--no-report")
        ended = Ended(0, "", 0.0)
        if name in ("sweep", "size", "replay"):
            ended = self._do(name, out)
        elif did_not_end(out):
            ended = call(self.base, words)
            if ended.code == 2 and "--force" in ended.err:  # killed before it had written what to run
                ended = self._again(name, out)
        elif not (out / RUN_FILE).is_file():
            ended = self._again(name, out)
        if ended.code not in (0, 1):
            return f"does not go on: {ended}"
        left = [path.name for path in out.rglob(".part-*")]
        if self._result(name, out) != self.wanted[name]:
            return "another result than undisturbed"
        return f"leaves {left}" if left and name in ("sweep", "size") else ""

    def _again(self, name: str, out: Path) -> Ended:
        if name == "rerun":
            shutil.rmtree(out, ignore_errors=True)
            return self._do(name, out)
        scenario = "sumo.yaml" if name == "run in SUMO" else "ticks.yaml"
        return call(self.base, ("run", scenario, "--out", str(out), "-q", "--force"))


def kill_all(trials: Trials, kills: int, seed: int, tell: Callable[[dict[str, Any]], None]) -> list[dict[str, Any]]:
    """Draw commands and moments; a row for each kill."""
    rng = random.Random(seed)
    rows = []
    for number in range(kills):
        name = rng.choices(COMMANDS, WEIGHTS)[0]
        part = rng.uniform(0.0, 1.05)
        row = {"number": number, "command": name, "part": round(part, 4), "wrong": trials.trial(name, part)}
        rows.append(row)
        tell(row)
    return rows


def main() -> int:
    """Make the kills, print the bad ones and a table; 1 if any was bad."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--csv", type=Path)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        rows = kill_all(Trials(Path(folder)), given.kills, given.seed, lambda row: row["wrong"] and print("BAD", row))
    frame = pd.DataFrame(rows).assign(bad=[bool(row["wrong"]) for row in rows])
    table = frame.groupby("command").agg(kills=("bad", "size"), bad=("bad", "sum"))
    stamp = {"seed": given.seed, "version": version("parking-sim"), "date": date.today().isoformat()}
    table = table.assign(**stamp, made=f"kills.py --kills {given.kills} --seed {given.seed}").reset_index()
    print(table.to_string())
    if given.csv:
        table.to_csv(given.csv, index=False)
    return int(table.bad.any())


if __name__ == "__main__":
    sys.exit(main())

"""Every fenced block of every page runs, is checked, or bears a mark that says why it does not run.

The blocks of a page run one after the other, in one folder, as a reader would run them. Python blocks and the
``parking-sim`` lines of ``sh`` blocks run. YAML blocks are read by what reads such files; a block that begins with
``# NAME.yaml`` is that file for what follows. Blocks without a language, and ``text``, show what comes out. A block
behind ``<!-- not run: REASON -->`` is not run, but its commands and options have to exist.
"""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import typer
import yaml

from parking_sim.cli import app
from parking_sim.config import check_scenario
from parking_sim.sweep_plan import load_sweep
from sumo_nets.freespace.floorplan import FloorPlan
from sumo_nets.layout import Layout

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
_BLOCK = re.compile(r"(?:<!-- not run: (?P<why>[^\n]+?) -->\n+)?^```(?P<language>\w*)\n(?P<text>.*?)^```$", re.M | re.S)
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT), "MPLBACKEND": "agg", "COLUMNS": "120"}


@dataclass(frozen=True)
class Block:
    """A fenced block.

    Attributes:
        why: why it is not run; empty if it is.
        language: what stands behind the fence.
        text: what stands in it.
    """

    why: str
    language: str
    text: str


def blocks(page: Path) -> list[Block]:
    found = _BLOCK.finditer(page.read_text(encoding="utf-8"))
    return [Block(match["why"] or "", match["language"], match["text"]) for match in found]


def commands(text: str) -> Iterator[list[str]]:
    """The words of each command of a block, without comments."""
    for line in text.replace("\\\n", " ").splitlines():
        if words := shlex.split(line, comments=True):
            yield words


def check_words(words: list[str]) -> None:
    """The command and its options exist."""
    command: Any = typer.main.get_command(app)
    rest = words[1:]
    while hasattr(command, "commands") and rest and not rest[0].startswith("-"):
        assert rest[0] in command.commands, words
        command, rest = command.commands[rest[0]], rest[1:]
    known = {option for parameter in command.params for option in (*parameter.opts, *parameter.secondary_opts)}
    assert {word.partition("=")[0] for word in rest if re.match(r"--?[a-z]", word)} <= {*known, "--help"}, words


def check_yaml(text: str, folder: Path) -> None:
    """A block is a scenario, a layout, a floor plan or a sweep, or keys of a scenario or a sweep."""
    content: dict[str, Any] = yaml.safe_load(text)
    if name := re.match(r"# ([\w.-]+\.yaml)\b", text):
        (folder / name[1]).write_text(text, encoding="utf-8")
    if content.keys() & {"grid", "list", "base"}:
        file = folder / "block.yaml"
        file.write_text(yaml.safe_dump({"base": "map1", **content}), encoding="utf-8")
        assert load_sweep(file)
    elif "outline" in content:
        FloorPlan.model_validate(content)
    elif content.keys() & {"aisles", "picture"}:
        Layout.model_validate(content)
    else:
        built = str(content.get("garage", "")).endswith(".net.xml.gz")  # by commands that need not have run
        check_scenario(
            {"agvs": 4, **content, **({"garage": "map1"} if built or "garage" not in content else {})}, "", folder
        )


def run(words: list[str], folder: Path) -> str:
    done = subprocess.run(words, cwd=folder, env=ENVIRONMENT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{words}: {done.stdout}{done.stderr}"
    return done.stdout


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_every_block_runs_or_says_why_not(page: Path, tmp_path: Path) -> None:
    for number, block in enumerate(blocks(page)):
        if block.language == "sh":
            for words in commands(block.text):
                if words[0] == "parking-sim":
                    check_words(words)
                if not block.why:
                    assert words[0] == "parking-sim", f"{page.name}: `{shlex.join(words)}` can't be run here: mark it"
                    run([sys.executable, "-m", "parking_sim", *words[1:]], tmp_path)
        elif block.language == "python":
            compile(block.text, page.name, "exec")
            if not block.why:
                (tmp_path / f"block_{number}.py").write_text(block.text, encoding="utf-8")
                run([sys.executable, f"block_{number}.py"], tmp_path)
        elif block.language == "yaml":
            check_yaml(block.text, tmp_path)
        else:
            assert block.language in ("", "text"), f"{page.name}: {block.language}"


def test_a_block_that_fails_is_found(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    for text in (
        "```python\n1 / 0\n```", "```sh\nls\n```", "```sh\nparking-sim run --nonsense\n```", "```yaml\nagvz: 4\n```",
        "<!-- not run: it takes long -->\n```sh\nparking-sim nonsense\n```", "```json\n{}\n```",
    ):  # fmt: skip
        page.write_text(f"# Page\n\n{text}\n", encoding="utf-8")
        with pytest.raises((AssertionError, ValueError)):
            test_every_block_runs_or_says_why_not(page, tmp_path)
    page.write_text("<!-- not run: reason -->\n```python\n1 / 0\n```\n\n```text\nout\n```\n", encoding="utf-8")
    test_every_block_runs_or_says_why_not(page, tmp_path)

"""The way from a clone to a sizing answer, every command as written."""

from __future__ import annotations

import os
import re
import shutil
import site
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGES = ("parking_sim", "sumo_nets", "controller", "demand", "analysis")


def commands() -> list[str]:
    text = (ROOT / "docs" / "sizing.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"^## From a clone to a sizing answer.*?^```sh\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    return str(block).splitlines()


def clone(target: Path) -> None:
    for package in PACKAGES:
        shutil.copytree(ROOT / package, target / package)  # with the compiled kernels: times are kept
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, target / name)


def test_five_commands_end_with_the_answer(tmp_path: Path) -> None:
    pytest.importorskip("hatchling")
    if shutil.which("python3.11") is None or sys.version_info[:2] != (3, 11):
        pytest.skip("the page's Python is 3.11")
    assert len(commands()) == 5
    clone(tmp_path / "clone")
    # what pip would download is there already
    found = {
        "PYTHONPATH": site.getsitepackages()[0],
        "PIP_NO_DEPS": "1",
        "PIP_NO_BUILD_ISOLATION": "0",
    }  # pip reads 0 as no
    done = subprocess.run(
        ["bash", "-e", "-c", "\n".join(commands())],
        cwd=tmp_path / "clone",
        env={**os.environ, **found, "PIP_NO_INDEX": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.search(r"\d AGVs? meets? 'retrieval p95 < 15 min' in map1, mall-saturday times 0.5 from ", done.stdout)
    assert (tmp_path / "clone" / "runs" / "size-map1-mall-saturday" / "report.html").is_file()

"""The wheel on the other Pythons that it names, each in an empty environment, where such a Python is installed.

The newest Python is tried, and each one with ``PARKING_SIM_ALL_PYTHONS=1``: an environment takes two minutes.
Environments stay in ``build/pythons``: packages are installed once, and anew when ``pyproject.toml`` has changed.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from test_wheel import OFFLINE, QUICK, build

ROOT = Path(__file__).parent.parent
NAMED = re.findall(r"Python :: (3\.\d+)", (ROOT / "pyproject.toml").read_text(encoding="utf-8"))
_OTHERS = [version for version in NAMED if version != f"{sys.version_info[0]}.{sys.version_info[1]}"]
OTHERS = _OTHERS if "PARKING_SIM_ALL_PYTHONS" in os.environ else _OTHERS[-1:]
NO_NETWORK = ("NewConnectionError", "Max retries", "Network is unreachable", "name resolution")
COMMANDS = {
    "doctor": "ok      SUMO:",
    "check-net map1": "; ok",
    "run quick.yaml --out run --plant sumo": "SUMO collisions            0",
}


def find_python(version: str) -> str | None:
    """An interpreter of a version that starts, on the search path or one of pyenv's."""
    kept = sorted((Path.home() / ".pyenv" / "versions").glob(f"{version}.*/bin/python"))
    for found in (shutil.which(f"python{version}"), *map(str, kept)):
        asked = [found, "-c", "import sys; print('%d.%d' % sys.version_info[:2])"]
        if found and subprocess.run(asked, capture_output=True, text=True, check=False).stdout.strip() == version:
            return found
    return None


def environment(version: str, python: str, wheel: Path) -> Path:
    """The folder of programs of an environment in which the wheel and all that it needs are installed."""
    needs = hashlib.sha256((ROOT / "pyproject.toml").read_bytes()).hexdigest()
    folder = ROOT / "build" / "pythons" / version
    stamp = folder / "needs.txt"
    pip = [folder / "bin" / "python", "-m", "pip", "--quiet", "--disable-pip-version-check", "--no-input", "install"]
    pip.append("--no-compile")  # most of what is installed is never imported
    if not stamp.is_file() or stamp.read_text() != needs:
        shutil.rmtree(folder, ignore_errors=True)
        subprocess.run([python, "-m", "venv", folder], check=True)
        done = subprocess.run([*pip, wheel], capture_output=True, text=True, check=False)
        if any(words in done.stderr for words in NO_NETWORK):
            pytest.skip(f"Python {version} was not tried: pip reaches no packages for it")
        assert done.returncode == 0, done.stderr
        stamp.write_text(needs)
    else:
        subprocess.run([*pip, *OFFLINE, "--force-reinstall", wheel], check=True)
    return folder / "bin"


@pytest.mark.parametrize("version", OTHERS)
def test_the_wheel_runs_on(version: str, tmp_path: Path) -> None:
    pytest.importorskip("hatchling")
    python = find_python(version)
    if python is None:
        pytest.skip(f"Python {version} was not tried: there is none here; install python{version} to try it")
    programs = environment(version, python, build(tmp_path))
    (tmp_path / "quick.yaml").write_text(QUICK, encoding="utf-8")
    for command, told in COMMANDS.items():
        words = [programs / "parking-sim", *command.split()]
        done = subprocess.run(words, cwd=tmp_path, env={"PATH": ""}, capture_output=True, text=True, check=False)
        assert done.returncode == 0, (command, done.stdout + done.stderr)
        assert told in done.stdout

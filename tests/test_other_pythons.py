"""The wheel on the other Pythons that it names, each in an empty environment, where such a Python is installed.

The newest Python is tried. With ``PARKING_SIM_ALL_PYTHONS=1`` each one is, and the oldest versions of all packages that
``pyproject.toml`` allows: an environment takes two minutes.
Environments stay in ``build/pythons``: packages are installed once, and anew when ``pyproject.toml`` has changed.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import subprocess
import sys
import tomllib
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


def environment(version: str, python: str, wheel: Path, packages: tuple[str, ...] = ()) -> Path:
    """The folder of programs of an environment in which the wheel and all that it needs are installed."""
    needs = hashlib.sha256((ROOT / "pyproject.toml").read_bytes()).hexdigest()
    folder = ROOT / "build" / "pythons" / (f"{version}-oldest" if packages else version)
    stamp = folder / "needs.txt"
    pip = [folder / "bin" / "python", "-m", "pip", "--quiet", "--disable-pip-version-check", "--no-input", "install"]
    pip.append("--no-compile")  # most of what is installed is never imported
    if not stamp.is_file() or stamp.read_text() != needs:
        shutil.rmtree(folder, ignore_errors=True)
        subprocess.run([python, "-m", "venv", folder], check=True)
        done = subprocess.run([*pip, wheel, *packages], capture_output=True, text=True, check=False)
        if any(words in done.stderr for words in NO_NETWORK):
            pytest.skip(f"Python {version} was not tried: pip reaches no packages for it")
        assert done.returncode == 0, done.stderr
        stamp.write_text(needs)
    else:
        subprocess.run([*pip, *OFFLINE, "--force-reinstall", wheel], check=True)
    return folder / "bin"


def oldest() -> tuple[str, ...]:
    """The oldest version of each package that is allowed, in pip's words."""
    with (ROOT / "pyproject.toml").open("rb") as file:
        needed = tomllib.load(file)["project"]["dependencies"]
    return tuple(re.sub(r">=([\d.]+),.*", r"==\1.*", need) for need in needed)


def test_every_package_has_an_oldest_and_a_newest_version() -> None:
    assert all(re.fullmatch(r"[a-z0-9]+(==[\d.]+|==[\d.]+\.\*)", need) for need in oldest())


@pytest.mark.parametrize("version", OTHERS)
def test_the_wheel_runs_on(version: str, tmp_path: Path) -> None:
    pytest.importorskip("hatchling")
    python = find_python(version)
    if python is None:
        pytest.skip(f"Python {version} was not tried: there is none here; install python{version} to try it")
    check_runs(environment(version, python, build(tmp_path)), tmp_path)


if "PARKING_SIM_ALL_PYTHONS" in os.environ:

    def test_the_wheel_runs_with_the_oldest_packages(tmp_path: Path) -> None:
        python = find_python(NAMED[0])
        assert python is not None
        check_runs(environment(NAMED[0], python, build(tmp_path), oldest()), tmp_path)


def check_runs(programs: Path, tmp_path: Path) -> None:
    """All packages fit each other, and the program runs."""
    checked = subprocess.run([programs / "python", "-m", "pip", "check"], capture_output=True, text=True, check=False)
    assert checked.returncode == 0, checked.stdout
    (tmp_path / "quick.yaml").write_text(QUICK, encoding="utf-8")
    for command, told in COMMANDS.items():
        words = [programs / "parking-sim", *command.split()]
        done = subprocess.run(words, cwd=tmp_path, env={"PATH": ""}, capture_output=True, text=True, check=False)
        assert done.returncode == 0, (command, done.stdout + done.stderr)
        assert told in done.stdout

"""One word for one thing: a request is the customer's wish, and a task is what the ACS makes of it."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
#: The changelog names what words were before; this file names the word to look for.
EXEMPT = {"CHANGELOG.md", "tests/test_vocabulary.py", "docs/release.md"}
#: The word alone or as a part of an identifier (``open_jobs``, ``JobState``).
JOB = re.compile(r"(?<![a-z])jobs?(?![a-z])|Jobs?(?![a-z])")


def test_a_task_has_no_second_name():
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False)
    if listed.returncode:
        pytest.skip("not a git checkout")
    found = []
    for name in sorted(set(listed.stdout.splitlines()) - EXEMPT):
        path = ROOT / name
        if path.is_file():
            lines = path.read_bytes().decode(errors="replace").splitlines() if b"\0" not in path.read_bytes() else []
            found += [f"{name}:{n}" for n, line in enumerate(lines, 1) if JOB.search(line)]
    assert not found

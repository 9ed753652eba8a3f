"""The page on Python: its blocks run one after the other, in one folder, as a reader would run them."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parent.parent


def test_the_blocks_run_in_their_order(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```", page, re.DOTALL | re.MULTILINE)
    assert len(blocks) == 6
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "MPLBACKEND": "agg"}
    told = []
    for number, block in enumerate(blocks):
        (tmp_path / f"block_{number}.py").write_text(block, encoding="utf-8")
        done = subprocess.run(
            [sys.executable, f"block_{number}.py"], cwd=tmp_path, env=environment, capture_output=True, text=True,
            check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        told.append(done.stdout)
    assert "<Summary: time_limit after 600 s" in told[0]
    assert "speed_mps" in told[1]
    assert "<svg" in (tmp_path / "parked.svg").read_text(encoding="utf-8")
    assert "<State at 60 s: 4 AGVs" in told[3]
    assert "<Layout row: 1 aisle, 14 slots, 1 home, pitch 7 m>" in told[4]
    assert "<Sizing: 1 AGV for 'turned away < 1 %', 3 runs>" in told[5]

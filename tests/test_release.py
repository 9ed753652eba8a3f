"""The version is the same wherever it is written, and the pictures of the pages are small."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent


def test_all_files_name_the_same_version_and_date() -> None:
    version = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    released = re.findall(r"^## (\d\S*) - (\S+)$", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    citation = dict(re.findall(r"^([\w-]+): (\S+)$", (ROOT / "CITATION.cff").read_text(encoding="utf-8"), re.MULTILINE))
    assert released[0] == (version, citation["date-released"])
    assert citation["version"] == version
    assert f"## {version} - " in (ROOT / "docs" / "release.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("picture", sorted((ROOT / "docs" / "pictures").iterdir()), ids=lambda path: path.name)
def test_pictures_are_small_and_shown(picture: Path) -> None:
    assert picture.stat().st_size < 200_000
    pages = (ROOT / "README.md", *(ROOT / "docs").glob("*.md"))
    assert any(f"pictures/{picture.name}" in page.read_text(encoding="utf-8") for page in pages)

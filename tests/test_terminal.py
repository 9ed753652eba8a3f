"""Tables of the command line in 80 columns."""

from __future__ import annotations

import pytest

from parking_sim.terminal import table

FIGURES = {"breakdown at noon": "412.3", "saturday with 6 AGVs": "401.2", "difference": "-11.14",
           "95 % interval": "-1042.7 .. 1020.4", "seeds needed": "134"}  # fmt: skip
WORDS = ["customers turned away, share of those who came", "cars that wait for a bay, mean over time, cars"]


@pytest.mark.parametrize("width", [80, 100, 200])
def test_no_word_and_no_figure_is_cut(width: int) -> None:
    text = table([{"measure": words, **FIGURES} for words in WORDS], "a against b", width)
    lines = text.split("\n")
    assert max(map(len, lines)) <= width
    assert all(text.count(figure) == len(WORDS) for figure in FIGURES.values())
    assert {word for heading in FIGURES for word in heading.split()} <= set(text.split())
    first = " ".join(line.partition("  ")[0] for line in lines)
    assert all(words in first for words in WORDS)


def test_the_width_is_the_terminals_and_80_without_one(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = [{"measure": WORDS[0], **FIGURES}]
    monkeypatch.delenv("COLUMNS", raising=False)
    assert table(rows, "") == table(rows, "", 80)
    monkeypatch.setenv("COLUMNS", "200")
    assert table(rows, "") == table(rows, "", 200) != table(rows, "", 80)


def test_what_has_no_words_to_break_is_broken_in_the_first_column_and_made_wider_in_the_others() -> None:
    path, figures = "x" * 60, {str(k): "9" * 20 for k in range(4)}
    text = table([{"setting": path, **figures}], "", 80)
    assert text.count("9" * 20) == 4
    assert text.count("x") == 60
    assert path not in text

"""Fixtures that several test files use."""

from __future__ import annotations

import pytest

from parking_sim.plants.discrete import DiscretePlant


@pytest.fixture
def ticks_watched(monkeypatch: pytest.MonkeyPatch) -> None:
    """In discrete ticks nobody looks at footprints: look at each tick that nobody shares a place or changes places."""
    step = DiscretePlant.step

    def watched(plant: DiscretePlant) -> None:
        before = list(plant.at)
        step(plant)
        assert len(set(plant.at)) == len(plant.at), "two AGVs on one place"
        moved = {(u, v) for u, v in zip(before, plant.at, strict=True) if u != v}
        assert not any((v, u) in moved for u, v in moved), "two AGVs have passed through each other"

    monkeypatch.setattr(DiscretePlant, "step", watched)

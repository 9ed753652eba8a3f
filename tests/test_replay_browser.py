"""Replay and report in headless Chromium: they load from a file without network or complaint, and draw what happened.

Without Chromium these tests fail; ``PARKING_SIM_NO_BROWSER=1`` leaves them out.
"""

from __future__ import annotations

import math
import os
import random
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import Browser, browser
from test_replay import folder, little_run

from analysis.record import AgvSample, Recorder, TaskRow
from analysis.replay import LIMIT_BYTES, replay_page
from analysis.report import write_index
from analysis.tables import load_run, recorded_run
from sumo_nets.read import read_net

__all__ = ["folder"]

pytestmark = pytest.mark.skipif(
    bool(os.environ.get("PARKING_SIM_NO_BROWSER")), reason="PARKING_SIM_NO_BROWSER leaves out the tests of pages"
)


@pytest.fixture(scope="module")
def chromium(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with browser(tmp_path_factory.mktemp("profile")) as tab:
        yield tab


@pytest.fixture
def replay(chromium: Browser, folder: Path) -> Browser:
    """The replay of a run in SUMO, just loaded."""
    chromium.open(folder / "replay.html")
    chromium.wait("window.replay")
    return chromium


@pytest.fixture
def little(chromium: Browser, tmp_path: Path) -> Browser:
    """The replay of two AGVs, just loaded."""
    page = tmp_path / "replay.html"
    page.write_text(replay_page(little_run()), encoding="utf-8")
    chromium.open(page)
    chromium.wait("window.replay")
    return chromium


def drawn(tab: Browser, canvas: str = "scene") -> str:
    """What a canvas shows, as text that differs when a pixel does."""
    tab.run("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
    return str(tab.run(f"document.getElementById('{canvas}').toDataURL()"))


def middle(tab: Browser, selector: str) -> tuple[float, float]:
    x, y = tab.run(
        f"(() => {{ const b = document.querySelector({selector!r}).getBoundingClientRect();"
        " return [b.x + b.width / 2, b.y + b.height / 2]; })()"
    )
    return x, y


def pixel(tab: Browser, x_m: float, y_m: float) -> list[int]:
    """Colour of the scene at a place of the garage, once what was asked for is drawn."""
    script = (
        "new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done))).then(() => {"
        f" const p = replay.toScreen({x_m}, {y_m});"
        " return [...document.getElementById('scene').getContext('2d').getImageData(...p, 1, 1).data]; })"
    )
    return [int(value) for value in tab.run(script)]


def test_pages_load_from_a_file_without_network_or_complaint(chromium: Browser, folder: Path) -> None:
    index = write_index([folder], folder.parent / "index.html")
    for page in (folder / "replay.html", folder / "report.html", index):
        chromium.open(page)
        if page.name == "replay.html":
            chromium.wait("window.replay")
            chromium.run("replay.play(600)")
        time.sleep(0.5)
        assert chromium.requests == [page.as_uri()]
        assert chromium.complaints == []


def test_complaints_and_requests_are_noticed(chromium: Browser, tmp_path: Path) -> None:
    """The test above would see a page that does what it must not."""
    page = tmp_path / "bad.html"
    page.write_text("<img src='http://127.0.0.1:9/x.png'><script>console.error('oh'); nothing()</script>")
    chromium.open(page)
    chromium.wait("true")
    assert "http://127.0.0.1:9/x.png" in chromium.requests
    assert any("oh" in line for line in chromium.complaints)
    assert any("ReferenceError" in line for line in chromium.complaints)


def test_positions_drawn_are_the_records(replay: Browser, folder: Path) -> None:
    trajectory = load_run(folder).trajectory
    times = np.unique(trajectory["time_s"].to_numpy())
    rng = random.Random(4)
    for _ in range(10):
        k = rng.randrange(len(times))
        replay.run(f"replay.seek({times[k] * 1000})")
        shown = replay.run("replay.drawn.agvs")
        for row in trajectory[trajectory["time_s"] == times[k]].to_dict("records"):
            agv = shown[row["agv"]]
            assert math.dist((agv["x"], agv["y"]), (row["x_m"], row["y_m"])) < 0.01
            assert abs(math.remainder(agv["angle"] - math.radians(row["angle_deg"]), math.tau)) < 0.001
            assert pixel(replay, row["x_m"], row["y_m"])[3] == 255, "something is drawn there"


def test_positions_between_samples_lie_between_them(replay: Browser, folder: Path) -> None:
    trajectory = load_run(folder).trajectory
    tracks = [rows[["time_s", "x_m", "y_m"]].to_numpy().T for _, rows in trajectory.groupby("agv")]
    rng = random.Random(5)
    for _ in range(10):
        t = rng.uniform(0.0, 1190.0)
        for agv, (times, x, y) in zip(replay.run(f"replay.state({t * 1000}).agvs"), tracks, strict=True):
            assert math.dist((agv["x"], agv["y"]), (np.interp(t, times, x), np.interp(t, times, y))) < 0.02


def test_cars_are_drawn_where_they_are(replay: Browser, folder: Path) -> None:
    tasks = load_run(folder).tasks
    names = replay.run("replay.head.cars")
    for t in (400.0, 800.0, 1190.0):
        state = replay.run(f"replay.state({t * 1000})")
        slots = {names[car["car"]] for car in state["cars"] if car["place"] == 0}
        carried = {names[agv["car"]] for agv in state["agvs"] if agv["car"] >= 0}
        assert slots == set(tasks[(tasks["kind"] == "park") & (tasks["delivered_s"] <= t)]["car"])
        assert carried == set(tasks[(tasks["lifted_s"] <= t) & ~(tasks["delivered_s"] <= t)]["car"])


def test_play_and_pause(replay: Browser) -> None:
    before = drawn(replay)
    replay.run("replay.seek(200000)")
    replay.key(" ")
    replay.wait("replay.playing && replay.time > 203000")
    replay.key(" ")
    assert not replay.run("replay.playing")
    after, stopped = drawn(replay), replay.run("replay.time")
    assert after != before
    time.sleep(0.2)
    assert (drawn(replay), replay.run("replay.time")) == (after, stopped)


def test_speed(replay: Browser) -> None:
    assert replay.run("document.getElementById('speed').value") == "10"
    for key, speed in (("ArrowUp", 30), ("ArrowDown", 10), ("ArrowDown", 5)):
        replay.key(key)
        assert replay.run("+document.getElementById('speed').value") == speed
    replay.run("replay.play(600)")
    replay.wait("!replay.playing")
    assert replay.run("replay.time === replay.head.end"), "it stops at the end"


def test_scrub(replay: Browser) -> None:
    before = drawn(replay)
    x, y = middle(replay, "#bar")
    replay.click(x, y)
    assert abs(replay.run("replay.time") - 600_000) < 3000
    half = drawn(replay)
    width = replay.run("document.getElementById('bar').clientWidth")
    replay.mouse("mousePressed", x, y, button="left", buttons=1, clickCount=1)
    replay.mouse("mouseMoved", x + width / 4, y, button="left", buttons=1)
    replay.mouse("mouseReleased", x + width / 4, y, button="left", clickCount=1)
    assert abs(replay.run("replay.time") - 900_000) < 3000
    assert len({before, half, drawn(replay)}) == 3
    for key, shift, step in (("ArrowRight", False, 5), ("ArrowLeft", True, -60), ("Home", False, None)):
        was = replay.run("replay.time")
        replay.key(key, shift)
        assert replay.run("replay.time") == (0 if step is None else was + step * 1000)


def test_zoom_and_pan(replay: Browser) -> None:
    floor, scene, view = drawn(replay, "floor"), drawn(replay), replay.run("replay.view")
    x, y = middle(replay, "#stage")
    replay.mouse("mouseWheel", x + 100, y + 50, deltaX=0, deltaY=-300)
    replay.wait(f"replay.view.scale > {view['scale']}")
    near = drawn(replay, "floor")
    assert near != floor
    assert drawn(replay) != scene
    fixed = replay.run("replay.view")
    assert (fixed["x"], fixed["y"]) != (view["x"], view["y"]), "the place under the pointer stays"
    replay.mouse("mousePressed", x, y, button="left", buttons=1, clickCount=1)
    replay.mouse("mouseMoved", x + 80, y, button="left", buttons=1)
    replay.mouse("mouseReleased", x + 80, y, button="left", clickCount=1)
    assert replay.run("replay.view.x") == pytest.approx(fixed["x"] - 80 / fixed["scale"])
    assert drawn(replay, "floor") != near
    replay.key("0")
    assert replay.run("replay.view") == view
    replay.key("+")
    replay.key("-")
    assert replay.run("replay.view.scale") == pytest.approx(view["scale"])


def test_follow_an_agv_and_a_car(replay: Browser) -> None:
    replay.run("replay.seek(600000)")
    before = drawn(replay)
    replay.key("f")
    replay.wait("Math.hypot(replay.drawn.agvs[0].x - replay.view.x, replay.drawn.agvs[0].y - replay.view.y) < 0.2")
    assert drawn(replay) != before
    assert "AGV 0" in replay.run("document.getElementById('card').textContent")
    replay.run("replay.play(60)")
    replay.wait("replay.time > 640000")
    replay.run("replay.pause()")
    replay.wait("Math.hypot(replay.drawn.agvs[0].x - replay.view.x, replay.drawn.agvs[0].y - replay.view.y) < 0.2")
    replay.key("Escape")
    assert replay.run("document.getElementById('card').hidden")
    replay.key("0")  # all of the garage, or the other AGV may be outside
    agv = replay.run("replay.drawn.agvs[2]")
    left, top = replay.run("(b => [b.x, b.y])(document.getElementById('stage').getBoundingClientRect())")
    x, y = replay.run(f"replay.toScreen({agv['x']}, {agv['y']})")
    replay.click(left + x, top + y)
    replay.wait("document.getElementById('following').textContent.includes('AGV 2')")
    replay.run("document.querySelector('[data-tab=cars]').click()")
    car = replay.run("replay.drawn.cars[0].car")
    name = replay.run(f"replay.head.cars[{car}]")
    replay.run(f"[...document.querySelectorAll('#list .row')].find(r => r.textContent.includes('{name}')).click()")
    centred = "c => c && Math.hypot(c.x - replay.view.x, c.y - replay.view.y) < 0.2"
    replay.wait(f"({centred})(replay.drawn.cars.find(c => c.car === {car}))")
    assert name in replay.run("document.getElementById('card').textContent")


def test_reversal_is_no_spin_and_turns_take_the_short_way(little: Browser) -> None:
    for t in range(17_000, 21_000, 250):
        first, second = little.run(f"replay.state({t}).agvs")
        assert math.sin(first["angle"]) == pytest.approx(0.0, abs=1e-9), "it stays on its axis"
        assert math.cos(second["angle"]) < math.cos(math.radians(178.9))
        assert first["x"] == pytest.approx(30.0 - 0.05 * t / 1000, abs=0.01)


def test_deadlock_is_marked_and_told(little: Browser) -> None:
    little.run("replay.seek(70000)")
    before = drawn(little)
    bar = little.run("document.getElementById('track').toDataURL()")
    little.key("n")
    assert little.run("replay.time") == 80_000, "the beginning of the wait"
    assert drawn(little) != before
    agv = little.run("replay.drawn.agvs[0]")
    ring = pixel(little, agv["x"], agv["y"] + 3.5)
    assert ring[0] > 150
    assert ring[1] < 120, "a red ring"
    assert little.run("document.getElementById('track').toDataURL()") != bar
    little.wait("document.getElementById('list').textContent.includes('in a deadlock')")
    little.run("document.querySelector('[data-tab=deadlocks]').click()")
    story = little.run("document.getElementById('list').textContent")
    for words in ("0:01:40", "AGV 0, 1 at c", "head on", "in vain: leader: no way", "by pull over, 140 s after"):
        assert words in story
    little.run("replay.seek(230000)")
    assert pixel(little, little.run("replay.drawn.agvs[0].x"), 3.5)[3] == 0


def test_help_legend_and_theme(little: Browser) -> None:
    light = drawn(little, "floor")
    little.key("?")
    assert not little.run("document.getElementById('help').hidden")
    little.key("Escape")
    assert little.run("document.getElementById('help').hidden")
    little.key("l")
    assert little.run("document.getElementById('legend').open")
    little.key("t")
    assert drawn(little, "floor") != light


def test_too_old_a_browser_is_told(chromium: Browser, folder: Path, tmp_path: Path) -> None:
    page = tmp_path / "old.html"
    text = (folder / "replay.html").read_text(encoding="utf-8")
    page.write_text(text.replace("<body>", "<body><script>delete window.DecompressionStream</script>", 1))
    chromium.open(page)
    chromium.wait("document.getElementById('message').textContent.includes('too old')")


def crowded_hour() -> Any:
    """An hour with 64 AGVs that never stand still, on the largest floor, which is full of cars."""
    net = read_net("map3")
    recorder = Recorder()
    recorder.floor(net.graph)
    recorder.shapes(net)
    slots = [net.graph.names[v] for v in net.graph.slots]
    for k, slot in enumerate(slots):
        recorder.event(0.0, "car_initial", car=f"car{k:03d}", vertex=slot)
    rng = np.random.default_rng(2)
    low, high = net.graph.xy.min(axis=0), net.graph.xy.max(axis=0)
    at, heading = rng.uniform(low, high, (64, 2)), rng.uniform(0.0, math.tau, 64)
    for k in range(1800):
        heading += rng.normal(0.0, 0.3, 64)
        at = np.clip(at + 2.5 * np.stack([np.cos(heading), np.sin(heading)], axis=1), low, high)
        samples = [AgvSample(i, *at[i], math.degrees(heading[i]), 1.25) for i in range(64)]
        recorder.sample(2.0 * k, samples, ["returning_with_car"] * 64, [""] * 64, [0.5] * 64)
        recorder.timeline(2.0 * k, 5, 0, 900, 3, 64)
        for i in rng.integers(0, 64, 32).tolist():
            recorder.plan(2.0 * k, i, 3, rng.integers(0, len(net.graph.names), 10).tolist())
    for i in range(64):
        row = TaskRow(
            i,
            "retrieve",
            f"car{i:03d}",
            "waiting",
            agv=i,
            origin=slots[i],
            requested_s=0.0,
            assigned_s=0.0,
            lifted_s=1.0,
        )
        recorder.task(row)
    return recorded_run(recorder, {}, "crowded")


def test_an_hour_with_64_agvs_is_small_and_smooth(chromium: Browser, tmp_path: Path) -> None:
    page = tmp_path / "replay.html"
    page.write_text(replay_page(crowded_hour()), encoding="utf-8")
    assert page.stat().st_size < LIMIT_BYTES / 2
    chromium.open(page, 1920, 1080)
    chromium.wait("window.replay")
    drawing = (
        "(() => { const t = performance.now(); for (let i = 0; i < 40; i++) replay.seek(90000 * i);"
        " return (performance.now() - t) / 40; })()"
    )
    best = min(chromium.run(drawing) for _ in range(3))
    print(f"{page.stat().st_size:,} bytes, {best:.1f} ms a frame without GPU")
    assert best < 40.0, "milliseconds a frame, drawn without GPU"

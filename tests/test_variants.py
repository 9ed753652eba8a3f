"""Variants have names that tell them apart, whatever differs, and runs of two variants are never taken for one."""

from __future__ import annotations

import json
import re
import shlex
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from analysis.compare import select_runs, split_choice
from analysis.record import Recorder
from analysis.report import page_title
from analysis.runs import load_runs
from analysis.sweep_report import sweep_variants, write_sweep_report
from analysis.tables import load_run
from analysis.variants import by_scenario, tell_apart, value_text
from parking_sim.cli import main
from parking_sim.sweep_plan import load_sweep
from sumo_nets.errors import InputError

GROUPS = st.recursive(
    st.none() | st.booleans() | st.integers(-2, 2) | st.sampled_from(["a", "b", "1", "a (1)", "", "kind"]),
    lambda inner: (
        st.lists(inner, max_size=2) | st.dictionaries(st.sampled_from(["kind", "a", "b", "c"]), inner, max_size=3)
    ),
    max_leaves=6,
)


#: Whatever else the machine has to do.
UNHURRIED = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])


def same(a: Any, b: Any) -> bool:
    """Equal as YAML has it: true is not 1."""
    return json.dumps(a, sort_keys=True) == json.dumps(b, sort_keys=True)


@UNHURRIED
@given(st.lists(GROUPS, min_size=1, max_size=6))
def test_other_values_have_other_texts(values: list[Any]) -> None:
    texts = [value_text(shown) for shown in tell_apart(values)]
    for i, a in enumerate(values):
        for j, b in enumerate(values):
            assert (texts[i] == texts[j]) == same(a, b)


@UNHURRIED
@given(st.lists(st.dictionaries(st.sampled_from("abc"), GROUPS, max_size=3), min_size=1, max_size=5))
def test_runs_of_other_scenarios_are_other_variants(scenarios: list[dict[str, Any]]) -> None:
    names = [variant.name for variant in by_scenario({str(i): s for i, s in enumerate(scenarios)}).values()]
    for i, a in enumerate(scenarios):
        for j, b in enumerate(scenarios):
            assert (names[i] == names[j]) == same(a, b)


WORKLOADS = st.one_of(
    st.fixed_dictionaries({"kind": st.just("park_exit"), "cars": st.integers(1, 4)}),
    st.fixed_dictionaries(
        {"kind": st.just("poisson"), "arrivals_per_h": st.integers(1, 3)},
        optional={"duration_min": st.integers(5, 6)},
    ),
)
ENTRIES = st.fixed_dictionaries(
    {}, optional={"name": st.sampled_from(["x", "y", "agvs=1"]), "workload": WORKLOADS, "agvs": st.integers(1, 2)}
)


@UNHURRIED
@given(st.lists(ENTRIES, min_size=1, max_size=4), st.lists(WORKLOADS, max_size=2), st.booleans())
def test_a_sweep_pools_nothing(
    tmp_path_factory: pytest.TempPathFactory, entries: list[Any], grid: list[Any], named: bool
) -> None:
    path = tmp_path_factory.mktemp("sweep") / "sweep.yaml"
    data = {"base": {"garage": "map1", "agvs": 4, "plant": "discrete"}, "list": entries}
    if grid:
        data["grid"] = {"workload": {f"w{k}": w for k, w in enumerate(grid)} if named else grid}
    path.write_text(yaml.safe_dump(data))
    specs = ()
    with suppress(InputError):  # names or scenarios given twice
        specs = load_sweep(path)
    assert len({spec.variant.name for spec in specs}) == len(specs)
    assert len({spec.scenario.model_dump_json() for spec in specs}) == len(specs)
    assert not any(letter in spec.variant.name for spec in specs for letter in '{}[]"')


# --- the example of the docs, to its end ----------------------------------------------------------------------------

DOCS = Path(__file__).parent.parent / "docs" / "sweeps.md"
SMALL = "base: {garage: map1, plant: discrete, duration_s: 660, record: {sample_s: 60}}"


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", DOCS.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)


def command(line: str) -> int:
    with pytest.raises(SystemExit) as end:
        main(shlex.split(line)[1:])
    return int(end.value.code or 0)


@pytest.fixture(scope="module")
def days(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sweep of the docs, with the discrete plant and few seeds."""
    folder = tmp_path_factory.mktemp("docs")
    text = blocks("yaml")[0]
    for there, small in (("base: map1 ", f"{SMALL} "), ("seeds: 1..10", "seeds: 1..2")):
        assert there in text
        text = text.replace(there, small)
    (folder / "days.yaml").write_text(text, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert command("parking-sim sweep days.yaml --workers 1 -q") == 0
    return folder / "runs" / "days"


NAMES = ["quiet day", "saturday", "breakdown at noon"]


def test_values_of_the_grid_have_names(tmp_path: Path) -> None:
    (tmp_path / "sweep.yaml").write_text(f"{SMALL.replace('duration_s', 'agvs: 2, duration_s')}\n{blocks('yaml')[1]}")
    names = [spec.variant.name for spec in load_sweep(tmp_path / "sweep.yaml")]
    assert names == ["workload=quiet day", "workload=saturday"]


def test_every_variant_has_its_runs_under_its_name(days: Path) -> None:
    frame = load_runs(days).runs
    expected = {f"{name}, agvs={agvs}": 2 for name in NAMES for agvs in (2, 4)}
    assert frame["variant"].value_counts().to_dict() == expected
    for name, group in frame.groupby("variant"):
        assert group["workload.kind"].nunique() == group["agvs"].nunique() == 1
        assert (group["workload.kind"] == "poisson").all() == ("quiet" in str(name))
    measured = sweep_variants(load_runs(days))
    assert {of.variant.name: of.runs for of in measured} == expected


def test_the_tables_of_the_docs(days: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(days.parent.parent)
    (asked,) = (block for block in blocks("python") if "load_runs" in block)
    found: dict[str, Any] = {}
    exec(asked, found)
    answer = found["found"].sql("SELECT variant, count(*) AS n FROM tasks JOIN runs USING (run) GROUP BY variant").df()
    assert set(answer["variant"]) == {f"{name}, agvs={agvs}" for name in NAMES for agvs in (2, 4)}


def test_the_report_names_variants_and_says_what_they_are(days: Path) -> None:
    page = write_sweep_report(days).read_text(encoding="utf-8")
    for words in (
        '<td class="n">breakdown at noon</td>',
        "12 runs of 6 variants",
        "workload.kind=profile",
        "breakdown",
        "11:30:00, none for some variants",
    ):
        assert words in page
    assert "{&#34;" not in page
    assert "{'" not in page


def test_comparison_by_name(days: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(days.parent.parent)
    (line,) = (block for block in blocks("sh") if "compare" in block)
    assert command(line.replace("\\\n", " ").replace(" --warmup 10", "")) == 0
    said = capfd.readouterr().out
    assert "breakdown at noon, agvs=4" in " ".join(said.split())
    assert (days.parent.parent / "change.svg").is_file()


@pytest.mark.parametrize(
    ("wanted", "agvs"),
    [("saturday, agvs=4", 4), ("saturday,agvs=2", 2), ("agvs=4,name=saturday", 4), ("agvs=2, saturday,step_s=0.5", 2)],
)
def test_ways_to_pick_a_variant(days: Path, wanted: str, agvs: int) -> None:
    runs = select_runs(f"{days}:{wanted}")
    assert {variant.name for variant in runs.variants.values()} == {f"saturday, agvs={agvs}"}


@pytest.mark.parametrize(
    ("wanted", "complaint"),
    [
        (
            "saturday",
            "has several variants: pick one, such as .*:saturday, agvs=2; there are saturday, agvs=2; sat",
        ),
        ("sunday", "variant: 'sunday': no such run; there are quiet day, agvs=2;"),
        ("name=sunday", "name: 'sunday': no such run; there are quiet day; saturday; breakdown at noon"),
        ("agv=2", "agv: no such key; these vary: name, agvs"),
    ],
)
def test_variants_that_are_not_there(days: Path, wanted: str, complaint: str) -> None:
    with pytest.raises(InputError, match=complaint):
        select_runs(f"{days}:{wanted}")


def test_a_run_of_a_sweep_bears_its_variants_name(days: Path) -> None:
    for row in json.loads((days / "sweep.json").read_text())["runs"]:
        run = load_run(days / "runs" / row["run"])
        assert (
            page_title(run)
            == f"{row['variant']} · map1 · {run.meta['scenario']['agvs']} AGVs · token · seed {row['seed']}"
        )


def test_colons_in_folders_and_names(tmp_path: Path) -> None:
    (tmp_path / "a:b").mkdir()
    (tmp_path / "a").mkdir()
    base = str(tmp_path)
    assert split_choice(f"{base}/a:b") == (f"{base}/a:b", "")
    assert split_choice(f"{base}/a:b:x:y") == (f"{base}/a:b", "x:y")
    assert split_choice(f"{base}/a:c:d") == (f"{base}/a", "c:d")
    assert split_choice("nowhere:x") == ("nowhere", "x")


def test_a_file_that_changed_under_its_name_is_another_variant(tmp_path: Path) -> None:
    for folder, seed, digest in (("a", 1, "1" * 64), ("b", 2, "1" * 64), ("c", 1, "2" * 64)):
        Recorder().write(tmp_path / folder, {"scenario": {"garage": "g", "seed": seed}, "inputs": {"g": digest}})
    names = load_runs(tmp_path).runs.set_index("run")["variant"]
    assert names["a"] == names["b"] == "inputs.g=11111111"
    assert names["c"] == "inputs.g=22222222"

"""The folder of a run: one run at a time, only its own files are touched, and a killed run leaves it readable."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import parking_sim as ps
from analysis.journal import Journal
from analysis.run_files import JOURNAL, RUN_FILE, did_not_end
from analysis.tables import load_run
from parking_sim.assembly import World
from parking_sim.cli import main
from parking_sim.folder_lock import FolderLock
from parking_sim.interrupts import ended_like_by_ctrl_c
from parking_sim.many_runs import open_folder
from parking_sim.plants.sumo_api import PlantError
from parking_sim.simulation import RunLoop
from sumo_nets.errors import InputError
from sumo_nets.whole_file import whole_file

BARE = ("--no-report", "-q")
SHORT = "{garage: map1, agvs: 2, plant: discrete, duration_s: 20, record: {replay: false}}"
LONG = "{garage: map1_thesis, agvs: 4, plant: discrete, workload: {kind: park_exit}, record: {replay: false}}"


def command(*words: object) -> int:
    with pytest.raises(SystemExit) as end:
        main([str(word) for word in words])
    return int(end.value.code or 0)


@pytest.fixture
def short(tmp_path: Path) -> Path:
    path = tmp_path / "short.yaml"
    path.write_text(SHORT)
    return path


@pytest.fixture
def long(tmp_path: Path) -> Path:
    path = tmp_path / "long.yaml"
    path.write_text(LONG)
    return path


def digest(folder: Path) -> object:
    return json.loads((folder / RUN_FILE).read_text())["digest"]


@pytest.mark.parametrize("words", [["run", "short.yaml"], ["run", "short.yaml", "--force"], ["sweep", "sweep.yaml"]])
def test_a_folder_that_is_being_written_is_left_alone(tmp_path, short, monkeypatch, capsys, words) -> None:
    monkeypatch.chdir(tmp_path)
    Path("sweep.yaml").write_text("{base: short.yaml, seeds: [1]}")
    Path("out").mkdir()
    with FolderLock(Path("out")):
        assert command(*words, "--out", "out", *BARE) == 2
    says = "--out: out: a run is being written there now; wait until it has ended, or give another folder"
    assert capsys.readouterr().err == f"error: {says}\n"
    assert [path.name for path in Path("out").iterdir() if path.name != "runs"] == []
    assert command(*words, "--out", "out", *BARE) == 0


def test_the_lock_dies_with_its_process(tmp_path: Path) -> None:
    if os.fork() == 0:
        lock = FolderLock(tmp_path)
        os._exit(0 if lock else 1)
    os.wait()
    FolderLock(tmp_path).release()


def test_force_removes_what_a_run_wrote_and_nothing_else(tmp_path, short) -> None:
    """Among what a run does not write: files with the endings of those that it writes."""
    out = tmp_path / "out"
    shutil.copy(Path(ps.__file__).parent / "examples" / "own_planner.py", tmp_path / "mine.py")
    (tmp_path / "own.yaml").write_text(SHORT.replace("agvs", "planner: mine.py:plan, agvs", 1))
    assert command("run", tmp_path / "own.yaml", "--out", out, *BARE) == 0
    own = ("notes.json", "plan.svg", "photo.png", "other.yaml", "my.parquet", "inputs/my.csv", "pages/report.html")
    (out / "pages").mkdir()
    for name in own:
        (out / name).write_text("mine")
    assert (out / "inputs" / "mine.py").is_file()
    assert command("run", short, "--out", out, "--force", *BARE) == 0
    assert [(out / name).read_text() for name in own] == ["mine"] * len(own)
    assert not (out / "inputs" / "mine.py").exists()


def _hears_hangups() -> None:
    """The tests themselves may run under ``nohup``, which their children would inherit."""
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_a_signal_ends_a_run_with_its_record(tmp_path, long, number, code) -> None:
    out = tmp_path / "out"
    words = [sys.executable, "-m", "parking_sim", "run", str(long), "--out", str(out), *BARE]
    process = subprocess.Popen(words, stderr=subprocess.PIPE, text=True, preexec_fn=_hears_hangups)
    while process.poll() is None and not ((out / JOURNAL).is_file() and (out / JOURNAL).stat().st_size > 10_000):
        time.sleep(0.01)
    process.send_signal(number)
    said = process.communicate(timeout=60)[1]
    assert process.returncode == code, said
    assert "Traceback" not in said
    assert load_run(out).meta["status"] == "interrupted"
    assert not did_not_end(out)


def test_a_second_ctrl_c_leaves_a_run_that_can_be_resumed(tmp_path, long, monkeypatch) -> None:
    out = tmp_path / "out"

    def stopped(self: RunLoop) -> None:
        if self.step >= 600:
            raise KeyboardInterrupt

    monkeypatch.setattr(RunLoop, "_tell", stopped)
    monkeypatch.setattr(RunLoop, "finish", lambda self, _status: stopped(self))
    assert command("run", long, "--out", out, *BARE) == 130
    assert did_not_end(out)
    assert load_run(out).meta["status"] == "killed"
    monkeypatch.undo()
    assert command("resume", out, *BARE) == 0
    assert load_run(out).meta["status"] == "finished"


def dies_at_rename(number: int, *words: object) -> bool:
    """Whether a forked process that runs a command has died at its so manieth rename of a file; else it has ended."""
    child = os.fork()
    if child == 0:
        rename, count = Path.replace, 0

        def dying(path: Path, target: Path) -> Path:
            nonlocal count
            if count == number:
                os._exit(99)
            count += 1
            return rename(path, target)

        Path.replace = dying  # type: ignore[method-assign, assignment]
        try:
            main([str(word) for word in words])
        except SystemExit as end:
            os._exit(int(end.code or 0))
        os._exit(98)
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    assert status in (0, 99)
    return status == 99


def test_a_run_that_dies_at_any_file_is_read_and_goes_on(tmp_path, short, capsys) -> None:
    """The first files of the record, one in the middle and the last ones are those at which the process dies."""
    assert command("run", short, "--out", tmp_path / "whole", *BARE) == 0
    wanted = digest(tmp_path / "whole")
    out = tmp_path / "out"
    assert not dies_at_rename(13, "run", short, "--out", tmp_path / "last", *BARE), "scenario, ten tables, metrics, run"
    for number in (0, 1, 6, 11, 12):
        assert dies_at_rename(number, "run", short, "--out", out, *BARE)
        assert did_not_end(out), number
        assert load_run(out).meta["status"] == "killed"
        assert command("explain", out) == 0
        assert command("run", short, "--out", out, *BARE) == 2
        assert f"go on with it: parking-sim resume {out}" in capsys.readouterr().err
        code = command("resume", out, *BARE)
        if not number:  # before it was written what to run
            assert code == 2
            assert "run its scenario again with --force" in capsys.readouterr().err
            assert command("run", short, "--out", out, "--force", *BARE) == 0
        assert digest(out) == wanted, number
        assert (out / "metrics.json").is_file()
        shutil.rmtree(out)


def test_a_replacement_that_dies_at_any_removal_can_be_repeated(tmp_path, short, monkeypatch) -> None:
    out = tmp_path / "out"
    number, unlink = 0, Path.unlink

    class DeadError(BaseException):
        pass

    while True:
        left = number

        def dying(path: Path, missing_ok: bool = False) -> None:
            nonlocal left
            if path.parent == out and path.exists():
                if not left:
                    raise DeadError
                left -= 1
            unlink(path, missing_ok)

        shutil.rmtree(out, ignore_errors=True)
        assert command("run", short, "--out", out, *BARE) == 0
        with monkeypatch.context() as patched:
            patched.setattr(Path, "unlink", dying)
            try:
                main(["run", str(short), "--out", str(out), "--force", *BARE])
            except DeadError:
                pass
            except SystemExit:
                break
        assert command("run", short, "--out", out, "--force", *BARE) == 0, number
        number += 5
    assert number > 13


def test_a_disk_that_is_full_is_told_in_one_line_and_the_record_so_far_is_read(tmp_path, long) -> None:
    """A limit on the size of files, which the journal meets while the run lasts."""
    out = tmp_path / "out"
    words = [sys.executable, "-m", "parking_sim", "run", str(long), "--out", str(out), *BARE]
    small = (60_000, 60_000)
    ended = subprocess.run(
        words, stderr=subprocess.PIPE, text=True, preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, small)
    )
    assert ended.returncode == 1
    assert ended.stderr.count("\n") == 1
    assert ended.stderr.startswith(f"error: {out}")
    assert "File too large; what is recorded so far can be read" in ended.stderr
    assert load_run(out).meta["status"] == "killed"
    assert command("resume", out, *BARE) == 0


def test_a_folder_that_goes_while_a_run_lasts_is_told_in_one_line(tmp_path, long, monkeypatch, capsys) -> None:
    out = tmp_path / "out"

    def gone(self: RunLoop) -> None:
        shutil.rmtree(out, ignore_errors=True)

    monkeypatch.setattr(RunLoop, "_tell", gone)
    assert command("run", long, "--out", out, *BARE) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "No such file or directory; what is recorded so far can be read" in said


@pytest.mark.parametrize("name", ["a b", "ä ö", "-x", "x" * 200, "$HOME", "a'b", "run.json", "  ", "[1]*?"])
def test_odd_names_of_folders(tmp_path, short, monkeypatch, name) -> None:
    monkeypatch.chdir(tmp_path)
    assert command("run", short, f"--out={name}", *BARE) == 0
    assert command("explain", f"./{name}") == 0
    assert load_run(name).meta["status"] == "time_limit"


def test_folders_that_cant_be_used_are_named(tmp_path, short, capsys) -> None:
    (tmp_path / "file").write_text("mine")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    for name in ("file", "file/within", "loop", "loop/within", "x" * 300):
        assert command("run", short, "--out", tmp_path / name, *BARE) == 2, name
        said = capsys.readouterr().err
        assert said.startswith(f"error: --out: {tmp_path / name}"), said
        assert said.count("\n") == 1
    assert (tmp_path / "file").read_text() == "mine"


@pytest.mark.parametrize("number", [errno.EBADF, errno.EINVAL, errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP])
def test_a_file_system_without_locks_on_folders_takes_runs(tmp_path, short, monkeypatch, number) -> None:
    """NFS turns such a lock into one of a file that is open for writing, and says EBADF."""

    def refused(_handle: int, _kind: int) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(fcntl, "flock", refused)
    assert command("run", short, "--out", tmp_path / "out", *BARE) == 0


def test_a_folder_that_was_refused_is_free_again(tmp_path, short, monkeypatch) -> None:
    """From Python, where the process lives on: by a sweep, and by a run whose plant does not start."""
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="holds files that are not a sweep's"):
        open_folder(tmp_path)
    FolderLock(tmp_path).release()
    monkeypatch.setattr(World, "plant", no_start)
    out = tmp_path / "out"
    out.mkdir()
    (out / "notes.txt").write_text("mine")
    with pytest.raises(PlantError), ps.Simulation(ps.load_scenario(str(short)), out):
        pass
    FolderLock(out).release()
    assert [path.name for path in out.iterdir()] == ["notes.txt"]


def no_start(*_: object) -> None:
    raise PlantError("SUMO did not start")


def test_a_plant_that_does_not_start_leaves_no_half_folder(tmp_path, short, monkeypatch, capsys) -> None:
    with monkeypatch.context() as patched:
        patched.setattr(World, "plant", no_start)
        assert command("run", short, "--out", tmp_path / "out", *BARE) == 1
    assert capsys.readouterr().err == "error: SUMO did not start\n"
    assert not (tmp_path / "out").exists()


def test_a_run_to_be_resumed_stays_when_its_plant_does_not_start(tmp_path, short, monkeypatch) -> None:
    assert dies_at_rename(5, "run", short, "--out", tmp_path / "out", *BARE)
    with monkeypatch.context() as patched:
        patched.setattr(World, "plant", no_start)
        assert command("resume", tmp_path / "out", *BARE) == 1
    assert command("resume", tmp_path / "out", *BARE) == 0


def test_without_a_display_an_earlier_run_is_left_as_it_is(tmp_path, short, monkeypatch, capsys) -> None:
    out = tmp_path / "out"
    assert command("run", short, "--out", out, *BARE) == 0
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    assert command("run", short, "--plant", "sumo", "--gui", "--force", "--out", out, *BARE) == 2
    assert "--gui: there is no display" in capsys.readouterr().err
    assert load_run(out).meta["scenario"]["plant"] == "discrete"


@pytest.mark.parametrize("name", ["inputs", JOURNAL])
def test_a_link_out_of_the_folder_is_not_followed(tmp_path, short, capsys, name) -> None:
    """A run that is replaced would remove the user's own file of the same name there."""
    out, elsewhere = tmp_path / "out", tmp_path / "elsewhere"
    shutil.copy(Path(ps.__file__).parent / "examples" / "own_planner.py", tmp_path / "mine.py")
    (tmp_path / "own.yaml").write_text(SHORT.replace("agvs", "planner: mine.py:plan, agvs", 1))
    assert command("run", tmp_path / "own.yaml", "--out", out, *BARE) == 0
    if name == JOURNAL:
        elsewhere.write_text("mine")
    else:
        (out / name).rename(elsewhere)
    (out / name).symlink_to(elsewhere)
    before = elsewhere.read_text() if elsewhere.is_file() else (elsewhere / "mine.py").read_text()
    assert command("run", short, "--out", out, "--force", *BARE) == 2
    assert capsys.readouterr().err.startswith(f"error: --out: {out / name}: is a link")
    with pytest.raises(InputError, match="is a link"):
        ps.simulate(ps.load_scenario(str(short)), out)
    assert (elsewhere.read_text() if elsewhere.is_file() else (elsewhere / "mine.py").read_text()) == before
    assert (out / RUN_FILE).is_file()


def test_a_scenario_that_names_folders_as_inputs_does_not_stop_force(tmp_path, short) -> None:
    out = tmp_path / "out"
    assert command("run", short, "--out", out, *BARE) == 0
    (out / "inputs").mkdir()
    (out / "scenario.yaml").write_text("{garage: inputs/.., planner: 'inputs/..:plan'}")
    assert command("run", short, "--out", out, "--force", *BARE) == 0


def test_a_name_that_is_not_utf_8_is_refused_before_anything_is_written(tmp_path, short, capsys) -> None:
    out = tmp_path / os.fsdecode(b"x\xff")
    assert command("run", short, "--out", out, *BARE) == 2
    assert "DuckDB reads names in UTF-8" in capsys.readouterr().err
    with pytest.raises(InputError, match="UTF-8"):
        ps.simulate(ps.load_scenario(str(short)), out)
    assert not out.exists()
    net = tmp_path / os.fsdecode(b"x\xff.net.xml")
    net.write_text("<net/>")
    assert command("draw-net", net, "--out", tmp_path / "x.svg") == 2
    assert "not in UTF-8" in capsys.readouterr().err


def test_what_a_journal_holds_is_not_written_again(tmp_path) -> None:
    """A disk that is full when a run is resumed would lose it: the file stays what it is, less its last half line."""
    (tmp_path / JOURNAL).write_bytes(b'1.0\n2.0\n["ev')
    before = (tmp_path / JOURNAL).stat().st_ino
    resource_limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4, resource_limit[1]))
    try:
        Journal(tmp_path, resumed=True).close(finished=False)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, resource_limit)
    assert (tmp_path / JOURNAL).read_bytes() == b"1.0\n2.0\n"
    assert (tmp_path / JOURNAL).stat().st_ino == before


def test_a_disk_that_is_full_is_told_with_the_files_name(tmp_path) -> None:
    """The system names no file when a write fails, only when opening does."""
    with pytest.raises(OSError, match=r"No space left on device: '.*/x'"), whole_file(tmp_path / "x"):
        raise OSError(errno.ENOSPC, "No space left on device")


def test_closed_standard_streams_do_no_harm(tmp_path, short) -> None:
    """Files of the record must not get their numbers."""
    words = f"{sys.executable} -m parking_sim run {short} --out {tmp_path / 'out'} --no-report"
    assert subprocess.run(["sh", "-c", f"{words} 0<&- 1>&- 2>&-"]).returncode == 0
    assert command("explain", tmp_path / "out") == 0


def test_a_full_standard_output_is_told_in_one_line(tmp_path) -> None:
    with Path("/dev/full").open("w") as full:
        ended = subprocess.run([sys.executable, "-m", "parking_sim", "nets"], stdout=full, stderr=subprocess.PIPE)
    assert (ended.returncode, ended.stderr) == (1, b"error: standard output: No space left on device\n")


def test_a_signal_that_is_ignored_stays_ignored() -> None:
    """As under nohup, where a terminal that is closed ends nothing."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with ended_like_by_ctrl_c() as came:
            os.kill(os.getpid(), signal.SIGHUP)
        assert came == []
        assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    except KeyboardInterrupt:  # which would end all tests
        pytest.fail("the signal was heard")
    finally:
        signal.signal(signal.SIGHUP, before)


def test_a_sweep_that_is_told_to_end_does_not_wait_for_its_runs(tmp_path) -> None:
    """Only the sweep gets the signal, as from ``kill``; its run would go on for weeks of simulated time."""
    (tmp_path / "sweep.yaml").write_text(
        "{base: {garage: map1, agvs: 2, plant: discrete, max_time_s: 2000000, workload: {kind: poisson,"
        " arrivals_per_h: 20, duration_min: 30000}, record: {replay: false}}, seeds: [1]}"
    )
    out = tmp_path / "out"
    words = [sys.executable, "-m", "parking_sim", "sweep", str(tmp_path / "sweep.yaml"), "--workers", "1"]
    process = subprocess.Popen([*words, "--out", str(out)], stderr=subprocess.PIPE, text=True)
    try:
        while process.poll() is None and not any(path.stat().st_size for path in out.glob(f"runs/*/{JOURNAL}")):
            time.sleep(0.01)
        process.terminate()
        said = process.communicate(timeout=30)[1]
    finally:
        process.kill()
    assert (process.returncode, said) == (143, "interrupted\n")
    assert list((out / "runs").iterdir()) == []


def test_an_interrupt_while_a_kernel_is_loaded_is_an_interrupt(tmp_path, monkeypatch) -> None:
    """numba tells of it by another error, whichever kernel is the first to be called."""

    def interrupted(*_: object) -> object:
        raise SystemError("CPUDispatcher returned a result with an exception set") from KeyboardInterrupt()

    monkeypatch.setattr("controller.planning.Planning.step", interrupted)
    scenario = ps.load_scenario("map1", {"plant": "discrete", "duration_s": 60.0})
    assert ps.simulate(scenario, tmp_path / "out").status == "interrupted"
    monkeypatch.setattr("controller.planning.Planning.step", lambda *_: (_ for _ in ()).throw(SystemError("else")))
    with pytest.raises(SystemError, match="else"):
        ps.simulate(scenario, tmp_path / "other")

"""Surveys that are killed: whatever dies, and whenever, a resumed store is the undisturbed one, byte by byte.

Processes are real: a scheduler and workers on the loopback address, clients, runs without any of them, ended by SIGKILL.
"""

import contextlib
import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import psutil
import pytest
from survey_scenes import line, tree

from pysas import survey
from pysas.survey import sections
from pysas.survey.image_store import SurveyStore

pytestmark = pytest.mark.cpp  # with either engine the same is tested

CUT = {"tile": 2.0, "section": 12.0, "pixel": (0.02, 0.04), "swath": (10.0, 36.0)}
RUN = """
import json, signal, sys
from pysas import survey
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs inherit that it is ignored
doing, path, out, address, cut = sys.argv[1:]
client = None
if address:
    import distributed
    client = distributed.Client(address, timeout=20)
try:
    if doing == "run":
        report = survey.run(survey.plan(path, **json.loads(cut)), out, client=client, threads=1)
    else:
        report = survey.resume(out, client=client, threads=1)
except Exception as error:
    sys.exit(f"{type(error).__name__}: {error}")
print(json.dumps(report.as_dict()))
"""
GONE = "ConnectionError: the scheduler is gone"
PATIENCE = 60.0  # s, for whatever shall happen


def until(true):
    """Wait for something."""
    end = time.monotonic() + PATIENCE
    while not true():
        assert time.monotonic() < end, "nothing happened"
        time.sleep(0.002)


def records(store):
    """How many tiles have one."""
    return sum(1 for _ in store.glob("*/records/*/zarr.json"))


class Processes:
    """Processes with groups of their own, none of which outlives the test."""

    def __init__(self, folder):
        self.folder, self.all, self.address = folder, [], ""

    def start(self, *arguments, **options):
        """Python with these arguments."""
        self.all.append(
            subprocess.Popen(
                [sys.executable, *map(str, arguments)],
                cwd=self.folder,
                start_new_session=True,
                text=True,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                **options,
            )  # fmt: skip
        )
        return self.all[-1]

    def survey(self, doing, path, store, address="", **options):
        """A run or a resumed one."""
        return self.start("-c", RUN, doing, path, store, address, json.dumps(CUT), **options)

    def scheduler(self):
        """A scheduler, and its address."""
        file = self.folder / f"scheduler{len(self.all)}.json"
        self.address = ""
        started = self.start(
            "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--no-show",
            "--scheduler-file", file,
        )  # fmt: skip
        until(lambda: started.poll() is not None or (file.exists() and file.read_text().endswith("}")))
        self.address = json.loads(file.read_text())["address"]
        return started

    def worker(self, *options, **more):
        """A worker of the scheduler: one process without a nanny unless asked."""
        return self.start(
            "-m", "distributed.cli.dask_worker", self.address, "--host", "127.0.0.1", "--no-dashboard", "--nthreads", "1",
            *(options or ("--no-nanny",)), "--death-timeout", "30", **more,
        )  # fmt: skip

    def kill(self, process, number=signal.SIGKILL):
        """End a process and those that it started."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, number)

    def ended(self, process):
        """What it said, once it has ended."""
        out, err = process.communicate(timeout=PATIENCE)
        return process.returncode, out, err

    def stop(self):
        for process in reversed(self.all):
            self.kill(process)
        for process in self.all:
            process.communicate(timeout=PATIENCE)


@pytest.fixture
def processes(tmp_path):
    started = Processes(tmp_path)
    try:
        yield started
    finally:
        started.stop()


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A line, its plan and the undisturbed store."""
    folder = tmp_path_factory.mktemp("scene")
    line(folder / "line.zarr", int16=True)
    plan = survey.plan(folder / "line.zarr", **CUT)
    report = survey.run(plan, folder / "whole.zarr", threads=1)
    assert report.complete and report.tiles == len(plan.tiles) > 35 and plan.strips[0].sections > 5
    return folder / "line.zarr", plan, tree(folder / "whole.zarr")


def same(store, whole):
    """Whether a store is the undisturbed one, as soon as workers that were left behind have ended what they did."""

    def equal():
        with contextlib.suppress(FileNotFoundError):  # what came and went
            return tree(store) == whole
        return False

    until(equal)
    return survey.verify(store) == []


def begun(store, rng, process, most=26):
    """Wait for a random moment before a run of 41 tiles ends."""
    count = rng.integers(0, most)
    until(lambda: records(store) >= count or process.poll() is not None)
    time.sleep(rng.uniform(0, 0.05))
    assert process.poll() is None, process.communicate()


# Each kind of death, once of each in the fast suite


def single(processes, scene, store, rng):
    """The only process is killed, three times."""
    path, _, _ = scene
    for doing in ("run", "resume", "resume"):
        process = processes.survey(doing, path, store)
        begun(store, rng, process)
        processes.kill(process)
        assert processes.ended(process)[0] == -9 and records(store) < 41
        if not store.exists():  # it had not come so far
            survey.run(scene[1], store, threads=1)
    assert survey.resume(store, threads=1).complete


def worker(processes, scene, store, rng):
    """A worker is killed; the others do its work, and the client does not notice."""
    path, plan, _ = scene
    processes.scheduler()
    nanny = rng.random() < 0.5
    workers = [processes.worker(*(["--nanny"] if nanny else [])) for _ in range(2)]
    client = processes.survey("run", path, store, processes.address)
    begun(store, rng, client)
    victim = workers[rng.integers(2)]
    if nanny:  # which starts another
        for child in psutil.Process(victim.pid).children():
            child.kill()
    else:
        processes.kill(victim)
    code, out, err = processes.ended(client)
    assert code == 0, err
    report = json.loads(out)
    assert report["complete"] and report["made"] == report["tiles"] == len(plan.tiles) and report["lost"] == []


def scheduler(processes, scene, store, rng):
    """The scheduler is killed: the client says so; another cluster, or none, goes on."""
    path, _, _ = scene
    victim = processes.scheduler()
    for _ in range(2):
        processes.worker()
    client = processes.survey("run", path, store, processes.address)
    begun(store, rng, client)
    processes.kill(victim)
    code, _, err = processes.ended(client)
    assert code == 1 and err.startswith(GONE), err
    if rng.random() < 0.5:
        assert survey.resume(store, threads=1).complete
        return
    processes.scheduler()
    processes.worker()
    code, out, err = processes.ended(processes.survey("resume", path, store, processes.address))
    assert code == 0 and json.loads(out)["complete"], err


def client(processes, scene, store, rng):
    """The client is killed; another one of the same cluster goes on, whose workers may still be at it."""
    path, _, _ = scene
    processes.scheduler()
    for _ in range(2):
        processes.worker()
    victim = processes.survey("run", path, store, processes.address)
    begun(store, rng, victim)
    processes.kill(victim)
    processes.ended(victim)
    code, out, err = processes.ended(processes.survey("resume", path, store, processes.address))
    assert code == 0 and json.loads(out)["complete"], err


DEATHS = {"single": single, "worker": worker, "scheduler": scheduler, "client": client}


def test_deaths_of_client_worker_and_scheduler_leave_no_trace(scene, processes, tmp_path):
    path, _, whole = scene
    rng, stores = np.random.default_rng(1), [tmp_path / "a.zarr", tmp_path / "b.zarr"]
    first = processes.scheduler()
    workers = [processes.worker(), processes.worker("--nanny")]
    victim = processes.survey("run", path, stores[0], processes.address)
    begun(stores[0], rng, victim, 15)
    processes.kill(victim)
    other = processes.survey("resume", path, stores[0], processes.address)
    begun(stores[0], rng, other, 24)
    processes.kill(workers[0])
    code, out, err = processes.ended(other)
    assert code == 0 and json.loads(out)["complete"], err
    assert same(stores[0], whole)
    last = processes.survey("run", path, stores[1], processes.address)
    begun(stores[1], rng, last, 25)
    processes.kill(first)
    code, _, err = processes.ended(last)
    assert code == 1 and err.startswith(GONE), err
    assert survey.resume(stores[1], threads=1).complete and same(stores[1], whole)


def test_deaths_of_the_only_process_leave_no_trace(scene, processes, tmp_path):
    single(processes, scene, tmp_path / "out.zarr", np.random.default_rng(1))
    assert same(tmp_path / "out.zarr", scene[2])


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("kind", DEATHS)
def test_deaths_at_random_times_leave_no_trace(kind, seed, scene, processes, tmp_path):
    DEATHS[kind](processes, scene, tmp_path / "out.zarr", np.random.default_rng([7, seed]))
    assert same(tmp_path / "out.zarr", scene[2])


def test_ctrl_c_ends_a_run_that_resume_completes(scene, processes, tmp_path):
    path, _, whole = scene
    store = tmp_path / "out.zarr"
    for _ in range(5):  # it may be done before the signal comes
        shutil.rmtree(store, ignore_errors=True)
        process = processes.survey("run", path, store)
        until(lambda: records(store) >= 3)
        os.kill(process.pid, signal.SIGINT)
        code, _, err = processes.ended(process)
        if records(store) < 41:
            break
    assert code != 0 and "KeyboardInterrupt" in err and 3 <= records(store) < 41
    assert survey.resume(store, threads=1).complete and same(store, whole)


# Disks, mounts, memory and threads


@pytest.fixture
def small_disk(tmp_path):
    """A file system of 4 MB where one may be mounted, and what makes it large; else a folder, and nothing."""
    folder = tmp_path / "disk"
    folder.mkdir()
    if os.name != "posix" or subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=4m", "pysas-test", folder], capture_output=True, check=False
    ).returncode:  # fmt: skip
        yield folder, None
        return
    try:
        yield folder, lambda: subprocess.run(["mount", "-o", "remount,size=128m", folder], check=True)
    finally:
        subprocess.run(["umount", "-l", folder], check=True)


def limited():
    """Files of this process hold less than a tile."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (400_000, 400_000))


@pytest.mark.parametrize(
    "cluster", [pytest.param(False, id="this process"), pytest.param(True, id="a worker", marks=pytest.mark.slow)]
)
def test_a_full_disk_ends_with_a_message_and_resume_completes(cluster, scene, processes, small_disk):
    path, plan, whole = scene
    folder, enlarge = small_disk
    store, address = folder / "out.zarr", ""
    limit = {} if enlarge else {"preexec_fn": limited}
    if cluster:
        processes.scheduler()
        processes.worker(**limit)
        address, limit = processes.address, {}
    code, out, err = processes.ended(processes.survey("run", path, store, address, **limit))
    said = "[Errno 28] No space left on device" if enlarge else "[Errno 27] File too large"
    assert code == 1 and out == "" and f"OSError: {said}: '{store}'" in err and records(store) < plan.strips[0].tiles
    assert not [name for name in tree(store) if "part" in name]
    again = processes.ended(processes.survey("resume", path, store, address)) if enlarge else None
    assert again is None or f"OSError: {said}: '{store}'" in again[2]  # still
    if enlarge:
        enlarge()
    assert survey.resume(store, threads=1).complete and same(store, whole)


def test_a_full_disk_leaves_no_store_that_is_not_planned(scene, processes, tmp_path):
    def none():
        resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))

    code, _, err = processes.ended(processes.survey("run", scene[0], tmp_path / "out.zarr", preexec_fn=none))
    assert code == 1 and err == f"OSError: [Errno 27] File too large: '{tmp_path / 'out.zarr'}'\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("lost", ["the line", "the store"])
def test_a_mount_that_is_lost_ends_with_a_message_and_resume_completes(lost, scene, tmp_path):
    source, _, whole = scene
    place = tmp_path / "mount"
    place.mkdir()
    path = place / "line.zarr" if lost == "the line" else source
    store = tmp_path / "out.zarr" if lost == "the line" else place / "out.zarr"
    if lost == "the line":
        shutil.copytree(source, path)

    def lose(share):
        if share > 0.4 and not (tmp_path / "elsewhere").exists():
            place.rename(tmp_path / "elsewhere")
            place.mkdir()

    with pytest.raises(FileNotFoundError, match=re.escape(str(path if lost == "the line" else store))) as caught:
        survey.run(survey.plan(path, **CUT), store, threads=1, progress=lose)
    assert f"pysas survey --resume -o {store} goes on from there" in caught.value.__notes__
    assert list(place.iterdir()) == []
    with pytest.raises(FileNotFoundError):
        survey.resume(store)
    place.rmdir()
    (tmp_path / "elsewhere").rename(place)
    assert all(SurveyStore(store).strips[0].record(tile) in (None, *done(whole, tile)) for tile in range(41))
    report = survey.resume(store, threads=1)
    assert report.complete and 0 < report.before < report.tiles
    found = tree(store)
    assert {name for name in whole if found.get(name) != whole[name]} <= {"000-port/zarr.json"} and len(found) == len(whole)


def done(whole, tile):
    """A tile's record in the undisturbed store, if it has one."""
    content = whole.get(f"000-port/records/{tile}/zarr.json")
    if content is not None:
        yield {name: value for name, value in json.loads(content)["attributes"].items() if name != "crc32"}


def test_a_process_makes_one_section_at_a_time(scene, tmp_path, monkeypatch):
    _, plan, whole = scene
    store, at_work, most = tmp_path / "out.zarr", [], []
    survey.run(plan, store, threads=1)
    for tile in range(plan.strips[0].tiles):
        SurveyStore(store).strips[0].forget(tile)
    make = sections._make

    def watched(*arguments):
        at_work.append(1)
        most.append(len(at_work))
        make(*arguments)
        at_work.pop()

    monkeypatch.setattr(sections, "_make", watched)
    with ThreadPoolExecutor(3) as pool:
        made = list(pool.map(lambda section: sections.image_section(str(store), 0, section, 1), range(plan.strips[0].sections)))
    assert most == [1] * plan.strips[0].sections and sum(map(len, made)) == plan.strips[0].tiles
    assert tree(store) == whole


@pytest.mark.slow
def test_workers_of_several_threads_and_of_too_little_memory(scene, processes, tmp_path):
    path, plan, whole = scene
    processes.scheduler()
    small = processes.worker("--no-nanny", "--memory-limit", "100MB")
    code, _, err = processes.ended(processes.survey("run", path, tmp_path / "out.zarr", processes.address))
    assert code == 1 and re.match(
        rf"ValueError: tcp://127\.0\.0\.1:\d+: has a memory limit of 100 MB, a section needs {plan.memory / 1e6:.0f} MB", err
    )
    processes.kill(small)
    processes.worker("--no-nanny", "--nthreads", "3")
    code, out, err = processes.ended(processes.survey("resume", path, tmp_path / "out.zarr", processes.address))
    assert code == 0 and json.loads(out)["complete"], err
    assert same(tmp_path / "out.zarr", whole)


POISON = """
import os
from pysas.survey import distributing, sections


def deadly(path, number, section, threads):
    if section == 2:
        os._exit(9)
    return sections.image_section(path, number, section, threads)


distributing.image_section = deadly
"""


@pytest.mark.slow
def test_a_section_that_kills_its_workers_is_given_up_and_the_others_are_made(scene, processes, tmp_path):
    path, plan, whole = scene
    store = tmp_path / "out.zarr"
    (tmp_path / "poison.py").write_text(POISON)
    processes.scheduler()
    processes.worker("--nanny", "--preload", tmp_path / "poison.py")
    code, out, err = processes.ended(processes.survey("run", path, store, processes.address))
    report = json.loads(out)
    lacking = len(plan.strips[0].tiles_of(2))
    assert code == 0 and report["lost"] == [{"strip": "000-port", "section": 2, "reason": "its worker died 4 times"}], err
    assert not report["complete"] and report["made"] == records(store) == plan.strips[0].tiles - lacking
    again = survey.resume(store, threads=1)
    assert again.complete and len(again.made) == lacking and same(store, whole)


@pytest.mark.slow
def test_two_that_resume_the_same_store_leave_it_whole(scene, processes, tmp_path):
    path, _, whole = scene
    store = tmp_path / "out.zarr"
    first = processes.survey("run", path, store)
    until(lambda: records(store) > 3)
    second = processes.survey("resume", path, store)
    for process in (first, second):
        code, out, err = processes.ended(process)
        assert code == 0 and json.loads(out)["complete"], err
    assert same(store, whole)


PEAK = "print([line.split()[1] for line in open('/proc/self/status') if line.startswith('VmHWM')][0])"


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="/proc tells peaks of memory")
def test_memory_does_not_grow_with_the_line(processes, tmp_path):
    peaks = []
    for pings in (480, 1920):
        path = tmp_path / f"{pings}.zarr"
        line(path, pings=pings, int16=True)
        process = processes.start("-c", RUN + PEAK, "run", path, tmp_path / f"{pings}-out.zarr", "", json.dumps(CUT))
        code, out, err = processes.ended(process)
        report, peak = out.splitlines()
        assert code == 0 and json.loads(report)["complete"], err
        peaks.append(1024 * int(peak))
        plan = survey.plan(path, **CUT, threads=1)
        assert peaks[-1] <= plan.memory
    assert peaks[1] <= 1.1 * peaks[0]

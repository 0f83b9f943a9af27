"""Files as such: permissions, what a write leaves behind that fails or is killed, and what is not read."""

from __future__ import annotations

import os
import socket
import stat
import subprocess
import sys
import tempfile
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pysas
from pysas.formats import files

pytestmark = pytest.mark.reference  # no engine takes part

LINUX = sys.platform.startswith("linux")


def echoes(samples: int = 40, value: float = 1.0) -> pysas.Echoes:
    tx = np.zeros((8, 3))
    return pysas.Echoes(np.full((8, samples), value, np.complex64), fs=1.0, fc=1.0, tx=tx, rx=tx)


def picture() -> pysas.Image:
    grid = pysas.Grid.plane(np.arange(3.0), np.arange(2.0))
    return pysas.Image(np.ones(grid.shape, np.complex64), grid, pysas.Report("given"), 1e5, 1500.0)


WRITERS: dict[str, Callable[[Path], Any]] = {
    "a.npz": lambda path: pysas.save(path, echoes()),
    "a.h5": lambda path: pysas.save(path, picture()),
    "a.png": lambda path: pysas.plot.quicklook(picture(), path),
    "a.pdf": lambda path: pysas.plot.quicklook(picture(), path),
}


@pytest.fixture(params=["without a name", "named"])
def parts(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Unfinished files as this system has them, and as others do."""
    if request.param == "named":
        monkeypatch.delattr(os, "O_TMPFILE", raising=False)
    return str(request.param)


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


@pytest.mark.skipif(os.name != "posix", reason="needs POSIX permissions")
@pytest.mark.parametrize("mask", [0o002, 0o077])
@pytest.mark.parametrize("name", WRITERS)
def test_a_new_file_has_the_permissions_of_the_umask(name: str, mask: int, parts: str, tmp_path: Path) -> None:
    before = os.umask(mask)
    try:
        WRITERS[name](tmp_path / name)
    finally:
        os.umask(before)
    assert mode(tmp_path / name) == 0o666 & ~mask


@pytest.mark.skipif(os.name != "posix", reason="needs POSIX permissions")
@pytest.mark.parametrize("kept", [0o600, 0o666, 0o750])
@pytest.mark.parametrize("name", WRITERS)
def test_a_replaced_file_keeps_its_permissions(name: str, kept: int, parts: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(b"old")
    path.chmod(kept)
    if os.geteuid() == 0:  # only root may give files away
        os.chown(path, 12345, 54321)
    owner = path.stat()
    WRITERS[name](path)
    found = path.stat()
    assert mode(path) == kept and (found.st_uid, found.st_gid) == (owner.st_uid, owner.st_gid)
    assert path.stat().st_size > 3 and [item.name for item in tmp_path.iterdir()] == [name]


DEMOTED = """
import os, sys
from pathlib import Path
import numpy as np
from pysas.formats import files, io
path, gid = Path(sys.argv[1]), 12346
if os.geteuid() == 0:
    os.chown(path.parent, 12345, gid)
    path.chmod(0o666)
    os.chown(path, 0, 0)
    os.setgroups([])
    os.setgid(gid)
    os.setuid(12345)
    with files.replacing(path) as file:
        file.write(b"new")
    # the old owner and group cannot be kept: what the group could do was not meant for this one
    assert path.read_bytes() == b"new" and path.stat().st_mode & 0o777 == 0o606, oct(path.stat().st_mode)
path.chmod(0o444)
try:
    with files.replacing(path):
        pass
except PermissionError as error:
    assert "read-only" in str(error)
    print("refused")
assert path.stat().st_mode & 0o777 == 0o444
path.chmod(0o644)
path.parent.chmod(0o555)
try:
    files.check_outputs([("-o", str(path.parent / "x"))], [], True)
except PermissionError as error:
    assert ".part" not in str(error)
    print("refused")
path.parent.chmod(0o755)
"""


@pytest.mark.skipif(os.name != "posix", reason="needs POSIX permissions")
def test_a_user_who_is_not_root() -> None:
    """In a process that becomes another user: root may write anywhere."""
    with tempfile.TemporaryDirectory() as folder:  # pytest's own are closed to others
        path = Path(folder) / "in" / "a"
        path.parent.mkdir()
        path.write_bytes(b"old")
        os.chmod(folder, 0o755)
        run = subprocess.run([sys.executable, "-c", DEMOTED, str(path)], capture_output=True, text=True, timeout=60)
    assert run.returncode == 0 and run.stdout == "refused\nrefused\n", run.stderr


@pytest.mark.parametrize("name", WRITERS)
def test_a_failed_write_leaves_the_old_file_and_nothing_else(
    name: str, parts: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / name
    for failure in (OSError(28, "No space left on device"), KeyboardInterrupt()):

        def fail(*_: Any, failure: BaseException = failure) -> None:
            raise failure

        with monkeypatch.context() as patch:
            patch.setattr(os, "fsync", fail)
            with pytest.raises(type(failure)):
                WRITERS[name](path)
        assert list(tmp_path.iterdir()) == []


LIMITED = """
import os, resource, sys
from pathlib import Path
import numpy as np
import pysas
from pysas import plot

rng = np.random.default_rng(3)
grid = pysas.Grid.plane(np.arange(300.0), np.arange(200.0))
data = rng.standard_normal((200, 300, 2)).view(complex)[..., 0].astype(np.complex64)
image = pysas.Image(data, grid, pysas.Report("given"), 1e5, 1500.0)
small = pysas.Image(data[:2, :3], pysas.Grid.plane(np.arange(3.0), np.arange(2.0)), pysas.Report("given"), 1e5, 1500.0)
for name in sys.argv[1:]:
    path = Path(name)
    binary = path.suffix in (".npz", ".h5")
    write = (lambda: pysas.save(path, image)) if binary else (lambda: plot.quicklook(small, path))
    write()
    size = path.stat().st_size
    path.write_bytes(b"old")
    limits = {0, 1, 100, *(2**k for k in range(9, 20)), *rng.integers(0, size, 10).tolist()} if binary else {0, 2**10, 2**13}
    for limit in sorted({min(n, size - 1) for n in limits} | {size - 1}):
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
        try:
            write()
        except OSError:
            pass
        else:
            raise AssertionError(limit)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
        assert path.read_bytes() == b"old" and os.listdir(path.parent) == [path.name]
    write()
    assert not binary or (path.stat().st_size == size and np.array_equal(pysas.load(path).data, data))
    path.unlink()
print("usable")
"""


@pytest.mark.skipif(os.name != "posix", reason="no limit on the size of files there")
def test_wherever_a_file_cannot_grow_the_old_one_stays_and_the_process_lives(tmp_path: Path) -> None:
    """A limit on the file's size in place of a full disk, at many places of the file. HDF5 itself dies of one at its exit."""
    command = [sys.executable, "-c", LIMITED, *(str(tmp_path / name) for name in WRITERS)]
    run = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert (run.returncode, run.stdout) == (0, "usable\n"), run.stderr


KILLED = """
import os, signal, sys
import numpy as np
import pysas
from pysas.formats import files

keep = files.os.fsync
files.os.fsync = lambda descriptor: os.kill(os.getpid(), signal.SIGKILL)
data = np.ones((8, 100_000), np.complex64)
pysas.save(sys.argv[1], pysas.Echoes(data, fs=1.0, fc=1.0, tx=np.zeros((8, 3)), rx=np.zeros((8, 3))))
"""


@pytest.mark.skipif(os.name != "posix", reason="needs POSIX signals")
@pytest.mark.parametrize("suffix", [".npz", ".h5"])
def test_a_killed_process_leaves_the_old_file(suffix: str, tmp_path: Path) -> None:
    """And nothing beside it where files without a name are to be had."""
    path = tmp_path / f"a{suffix}"
    path.write_bytes(b"old")
    run = subprocess.run([sys.executable, "-c", KILLED, str(path)], capture_output=True, timeout=60)
    assert run.returncode == -9 and path.read_bytes() == b"old"
    file, named = files._part(path, 0o600)
    file.close()
    if named is None:
        assert list(tmp_path.iterdir()) == [path]


STOPPED = """
import os, signal, sys
from pathlib import Path
import numpy as np
import pysas

def stop(*_):
    raise KeyboardInterrupt

signal.signal(signal.SIGALRM, stop)
path = Path(sys.argv[1])
tx = np.zeros((8, 3))
old, new = (pysas.Echoes(np.full((8, 4000), v, np.complex64), fs=1.0, fc=1.0, tx=tx, rx=tx) for v in (1, 2))
pysas.save(path, old)
stopped = 0
for delay in np.geomspace(1e-4, 2e-2, 120):
    try:
        signal.setitimer(signal.ITIMER_REAL, delay)
        pysas.save(path, new)
        signal.setitimer(signal.ITIMER_REAL, 0)
    except KeyboardInterrupt:
        stopped += 1
    assert len(np.unique(pysas.load(path).data)) == 1 and os.listdir(path.parent) == [path.name]
print(stopped > 20)
"""


@pytest.mark.skipif(not LINUX, reason="elsewhere a second stop within the first one's cleaning may leave a part")
def test_ctrl_c_while_hdf5_lays_out_a_file_is_a_keyboard_interrupt(tmp_path: Path) -> None:
    run = subprocess.run([sys.executable, "-c", STOPPED, str(tmp_path / "a.h5")], capture_output=True, text=True, timeout=60)
    assert (run.returncode, run.stdout) == (0, "True\n"), run.stderr


@pytest.mark.parametrize("name", WRITERS)
def test_without_overwrite_only_a_new_name_is_taken(
    name: str, parts: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / name

    def write() -> None:
        if name.endswith((".npz", ".h5")):
            pysas.save(path, echoes(), overwrite=False)
        else:
            pysas.plot.quicklook(picture(), path, overwrite=False)

    write()
    before = path.read_bytes()
    with pytest.raises(FileExistsError, match="exists: expected a new name"):
        write()
    assert path.read_bytes() == before
    path.unlink()
    monkeypatch.setattr(os, "fsync", lambda _: path.write_bytes(b"another's"))  # while this one is being written
    with pytest.raises(FileExistsError):
        write()
    assert path.read_bytes() == b"another's" and list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("suffix", [".npz", ".h5"])
def test_what_has_the_old_file_mapped_goes_on_seeing_it(suffix: str, tmp_path: Path) -> None:
    """Data mapped from the very file that they are saved to."""
    path = tmp_path / f"a{suffix}"
    data = (np.arange(8 * 5000).reshape(8, 5000) * (1 + 2j)).astype(np.complex64)
    pysas.save(path, echoes().replace(data=data))
    offset = path.read_bytes().index(data.tobytes())
    mapped = np.memmap(path, dtype=np.complex64, mode="r", offset=offset, shape=data.shape)
    for _ in range(2):
        pysas.save(path, echoes().replace(data=mapped))
        assert np.array_equal(mapped, data) and np.array_equal(pysas.load(path).data, data)


@pytest.mark.parametrize("suffix", [".npz", ".h5"])
def test_saving_takes_no_second_copy_of_the_data(suffix: str, tmp_path: Path) -> None:
    item = echoes(2**20)  # 64 MiB
    pysas.save(tmp_path / f"small{suffix}", echoes())  # what is imported is before the count
    for data in (item.data, np.asfortranarray(item.data)):
        tracemalloc.start()
        try:
            pysas.save(tmp_path / f"a{suffix}", item.replace(data=data))
            assert tracemalloc.get_traced_memory()[1] < 40 * 2**20  # blocks of 16 MiB
        finally:
            tracemalloc.stop()


NOT_FILES = """
import os, sys, warnings
import pysas
for name in sys.argv[1:]:
    try:
        pysas.load(name)
    except (ValueError, OSError) as error:
        print(type(error).__name__, name in str(error))
"""


@pytest.mark.skipif(os.name != "posix", reason="no such files there")
@pytest.mark.parametrize("suffix", [".npz", ".h5"])
def test_only_regular_files_are_read(suffix: str, tmp_path: Path) -> None:
    """In a process with a time limit: a pipe blocks, /dev/zero has no end."""
    names = [
        str(tmp_path / f"{kind}{suffix}") for kind in ("zero", "null", "full", "pipe", "link to a pipe", "socket", "terminal")
    ]
    for name, device in zip(names, ("zero", "null", "full"), strict=False):
        os.symlink(f"/dev/{device}", name)
    os.mkfifo(names[3])
    os.symlink(names[3], names[4])
    with socket.socket(socket.AF_UNIX) as server:
        before = os.getcwd()
        os.chdir(tmp_path)  # names of sockets are short
        try:
            server.bind(Path(names[5]).name)
        finally:
            os.chdir(before)
    os.symlink("/dev/ptmx", names[6])
    run = subprocess.run([sys.executable, "-c", NOT_FILES, *names], capture_output=True, text=True, timeout=30)
    assert run.stdout.split("\n")[:-1] == ["ValueError True"] * len(names), run.stderr
    (tmp_path / f"folder{suffix}").mkdir()
    with pytest.raises(OSError, match="folder"):
        pysas.load(tmp_path / f"folder{suffix}")
    os.symlink("loop" + suffix, tmp_path / f"loop{suffix}")
    for act in (pysas.load, lambda path: pysas.save(path, echoes())):
        with pytest.raises(OSError, match="loop"):
            act(tmp_path / f"loop{suffix}")


@pytest.mark.parametrize("path", [None, 1, b"a.npz", "a\0.npz", ["a.npz"]], ids=repr)
def test_what_is_no_name(path: Any) -> None:
    for act in (
        pysas.load,
        lambda path: pysas.save(path, echoes()),
        lambda path: files.check_outputs([("-o", path)], [], True),
    ):
        with pytest.raises((TypeError, ValueError), match="path="):
            act(path)


def test_a_directory_as_long_as_a_sparse_file_is_not_read(tmp_path: Path) -> None:
    """A zip file's end (APPNOTE.TXT 4.3.16) that says that all of 4 GB before it is its directory."""
    path = tmp_path / "a.npz"
    size = 2**32 - 2**16
    with open(path, "wb") as file:
        file.seek(size)
        file.write(b"PK\5\6" + bytes(8) + size.to_bytes(4, "little") + bytes(6))
    tracemalloc.start()
    try:
        with pytest.raises(ValueError, match="a.npz: .*directory"):
            pysas.load(path)
        assert tracemalloc.get_traced_memory()[1] < 20 * 2**20
    finally:
        tracemalloc.stop()


NO_MEMORY = """
import resource, sys
import pysas
import h5py
pysas.load  # and all that it needs
used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + 100 * 2**20, -1))
try:
    pysas.load(sys.argv[1])
except MemoryError as error:
    print(error)
print("usable")
"""


@pytest.mark.skipif(not LINUX, reason="needs RLIMIT_AS")
@pytest.mark.parametrize("suffix", [".npz", ".h5"])
def test_too_little_memory_is_no_damage(suffix: str, tmp_path: Path) -> None:
    """A whole file that holds more than fits, much of it zeros that take no room in it."""
    path = tmp_path / f"a{suffix}"
    pysas.save(tmp_path / "small.npz", echoes())
    with np.load(tmp_path / "small.npz") as file:
        fields = dict(file) | {"data": np.zeros((8, 2**22), np.complex64)}
    if suffix == ".npz":
        np.savez_compressed(path, **fields)
    else:
        import h5py

        with h5py.File(path, "w") as made:
            for name, value in fields.items():
                if name == "data":
                    made.create_dataset(name, data=value, chunks=(1, 2**16), compression="gzip", compression_opts=1)
                else:
                    made[name] = str(value) if value.dtype.kind == "U" else value
    run = subprocess.run([sys.executable, "-c", NO_MEMORY, str(path)], capture_output=True, text=True, timeout=60)
    assert run.stdout == f"{path}: data: no memory for 256 MiB, complex64 of shape (8, 4194304)\nusable\n", run.stderr

"""Files as such: which are read, how one takes another's place, and what is known of an output before the work begins.

Only regular files are read. A new file gets its name when complete and not before; until then it has no name where the
system allows that (Linux on most file systems), so that even a killed process leaves nothing; elsewhere a killed process
leaves a `.pysas-*.part` beside the target.
"""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
import stat
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import IO

_PERMISSIONS = 0o777


def name(path: str | os.PathLike[str]) -> str:
    """`path` as text."""
    text = os.fspath(path) if isinstance(path, str | os.PathLike) else None
    if not isinstance(text, str):
        raise TypeError(f"path={path!r:.60}: expected the name of a file, str or os.PathLike")
    if "\0" in text:
        raise ValueError(f"path={text!r:.60}: expected a name without a null character")
    return text


def opened(path: str | os.PathLike[str]) -> IO[bytes]:
    """A regular file for reading: a pipe would block, a device may have no end."""
    text = name(path)
    kind = os.stat(text).st_mode
    if stat.S_ISDIR(kind):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), text)
    if stat.S_ISREG(kind):
        # what has taken the file's place since is not waited for and not read either
        file = open(text, "rb", opener=lambda at, flags: os.open(at, flags | getattr(os, "O_NONBLOCK", 0)))
        if stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            return file
        file.close()
    raise ValueError(f"{text}: expected a regular file, found a pipe, a device or the like")


def small(path: str | os.PathLike[str], most: int, what: str) -> bytes:
    """The content of a regular file of at most `most` bytes; a larger one is an error that says `what` was expected."""
    with opened(path) as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise ValueError(f"{name(path)}: found more than {most} bytes, expected {what}")
    return content


@contextlib.contextmanager
def replacing(path: str | os.PathLike[str], *, overwrite: bool = True) -> Iterator[IO[bytes]]:
    """A new file that takes the place of `path` when the block ends, and is gone when the block fails.

    A file that is replaced keeps its permissions, and its owner and group where this process may give them; a new one has
    those of the umask. A link's target is replaced, not the link. Without `overwrite` only a new name is taken.
    """
    target, old = _target(path)
    if old is not None and not overwrite:
        raise FileExistsError(f"{name(path)}: exists: expected a new name")
    file, part = _part(target, 0o666 if old is None else old.st_mode & _PERMISSIONS)
    claimed = False
    try:
        if old is not None:
            _keep(file.fileno(), old)
        yield file
        file.flush()
        os.fsync(file.fileno())
        if part is None:
            part = _part_name(target.parent)
            # with a folder's descriptor Python asks the system to follow the link that /proc shows
            os.link(_shown(file), part, src_dir_fd=file.fileno())
        file.close()
        if not overwrite:
            with open(target, "xb"):  # fails where the name has been taken since
                claimed = True
        os.replace(part, target)
    except BaseException:
        with contextlib.suppress(OSError):
            file.close()
        if part is not None:
            with contextlib.suppress(OSError):
                part.unlink()
                if claimed:
                    target.unlink()
        raise


@contextlib.contextmanager
def naming(path: str) -> Iterator[None]:
    """What is wrong with what a file holds, with the file's name."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def check_outputs(outputs: Iterable[tuple[str, str]], inputs: Iterable[str], overwrite: bool) -> None:
    """Raise now what writing would raise after the work.

    Parameters
    ----------
    outputs : of (option, path)
        What will be written, by the option that names it.
    inputs : of path
        What is read: never replaced, under no name.
    overwrite : bool
        Whether a file that is there may be replaced.
    """
    read = []
    for path in inputs:
        with contextlib.suppress(OSError):  # reading will tell
            read.append(os.stat(name(path)))
    written: dict[tuple[int, int, str], str] = {}
    for option, path in outputs:
        target, old = _target(path)
        if old is not None and any(os.path.samestat(old, other) for other in read):
            raise ValueError(f"{option} {path}: is read by this command: expected another name")
        if old is not None and not overwrite:
            raise FileExistsError(f"{option} {path}: exists: expected a new name, or --overwrite")
        folder = os.stat(target.parent)
        other = written.setdefault((folder.st_dev, folder.st_ino, os.path.normcase(target.name)), option)
        if other != option:
            raise ValueError(f"{option} {path}: is the file of {other} too: expected two names")
        file, part = _part(target, 0o600)  # what only trying can tell: a file system that is read-only, a quota
        file.close()
        if part is not None:
            part.unlink()


def _target(path: str | os.PathLike[str]) -> tuple[Path, os.stat_result | None]:
    """Where writing to `path` ends, and what is there."""
    text = name(path)
    target = Path(os.path.realpath(text))
    try:
        old = os.stat(target)
    except FileNotFoundError:
        old = None
    if old is not None and not stat.S_ISREG(old.st_mode):
        raise ValueError(f"{text}: expected a regular file or a new name")
    if old is not None and not os.access(target, os.W_OK):
        raise PermissionError(errno.EACCES, "the file is read-only", text)
    if not target.parent.is_dir():
        raise FileNotFoundError(errno.ENOENT, "no such folder", str(target.parent))
    return target, old


def _part(target: Path, mode: int) -> tuple[IO[bytes], Path | None]:
    """A new file in the folder of `target`, and its name if it has one."""
    if hasattr(os, "O_TMPFILE"):
        with contextlib.suppress(OSError):  # a file system that has no files without names, or a folder that takes none
            file = os.fdopen(os.open(target.parent, os.O_TMPFILE | os.O_RDWR | os.O_CLOEXEC, mode), "w+b")
            if os.path.exists(_shown(file)):
                return file, None
            file.close()
    part = _part_name(target.parent)
    try:
        return open(part, "x+b", opener=lambda at, flags: os.open(at, flags, mode)), part
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(target)) from None


def _part_name(folder: Path) -> Path:
    return folder / f".pysas-{os.getpid()}-{secrets.token_hex(4)}.part"


def _shown(file: IO[bytes]) -> str:
    return f"/proc/self/fd/{file.fileno()}"


def _keep(descriptor: int, old: os.stat_result) -> None:
    """Give a file the permissions of `old`, and its owner and group as far as this process may."""
    if not hasattr(os, "fchown"):  # no permissions of POSIX
        return
    mode = old.st_mode & _PERMISSIONS
    made = os.fstat(descriptor)
    if made.st_uid != old.st_uid:
        with contextlib.suppress(OSError):
            os.fchown(descriptor, old.st_uid, -1)
    if made.st_gid != old.st_gid:
        try:
            os.fchown(descriptor, -1, old.st_gid)
        except OSError:
            mode &= ~stat.S_IRWXG  # they were another group's
    os.fchmod(descriptor, mode)

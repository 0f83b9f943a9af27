"""The two containers of named arrays that `io` keeps its schemas in: .npz and .h5 (h5py, extra `hdf5`).

Reading never unpickles and trusts no size: dtype and shape come from each field's header and are compared with the bytes
that lie in the file before anything is allocated. Both carry checksums: CRC-32 of each .npz member; in .h5 those of the
format's metadata, and CRC-32 of each array in its attribute "crc32" (files without it are read all the same).

HDF5 ends the process at its own exit where a file cannot be written (a full disk), so it never writes to one here: it lays
out the file in memory, without the arrays' bytes, and Python writes those and the layout.
"""

from __future__ import annotations

import _thread
import contextlib
import io
import math
import zipfile
import zlib
from collections.abc import Callable, Container, Iterator, Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np

from pysas import _checks
from pysas.formats.fields import Array, File, Streamed, allocated, blamed, bytes_of

Open = Callable[[IO[bytes]], contextlib.AbstractContextManager["File"]]
Write = Callable[[IO[bytes], "Mapping[str, Array | Streamed]"], None]

_MOST_EXPANSION = 1032  # deflate cannot expand by more ("Maximum Compression Factor", zlib technical details)
_MOST_HEADER = 2**16  # of an array in .npz; numpy's own take a hundred bytes
_CHUNK_BYTES = 2**20
_BLOCK_BYTES = 2**24  # written at once
_COMPACT_BYTES = 60_000  # HDF5 keeps data of less than 64 KiB in the (checksummed) object header where asked
_SAFE_FILTERS = {1, 2, 3, 32000}  # deflate, shuffle, Fletcher-32, LZF: built in, and none expands by more than deflate
_CHECKSUM = "crc32"


def container(path: str) -> tuple[Open, Write]:
    """How a file of this name is opened and written."""
    suffix = Path(path).suffix.lower()
    if suffix == ".npz":
        return _open_npz, _write_npz
    if suffix != ".h5":
        raise ValueError(f"{path}: found suffix {suffix!r}, expected .npz or .h5; pysas convert makes others of these")
    _h5py()
    return _open_h5, _write_h5


def npy_header(head: IO[bytes], size: int) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Shape, whether in Fortran's order, and dtype of an array in .npy of `size` bytes, which hold it and nothing else."""
    version = np.lib.format.read_magic(head)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, fortran, dtype = read(head)
    start = head.tell()
    declared = math.prod(shape) * dtype.itemsize
    if min(shape, default=0) < 0 or start + declared != size:
        raise ValueError(f"found {dtype} of shape {shape} in {size - start} bytes, expected {declared} bytes")
    return shape, fortran, dtype


class _Bounded:
    """A file that gives only pieces of what it has: a directory said to be as long as a sparse file is not read."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self.seek, self.tell, self.seekable = file.seek, file.tell, file.seekable

    def read(self, size: int = -1) -> bytes:
        most = 2 * _CHUNK_BYTES
        found = self._file.read(min(size, most + 1) if size >= 0 else most + 1)
        if len(found) > most:
            raise ValueError(f"found more than {most} bytes where its directory should be")
        return found


class _Npz(File):
    def __init__(self, archive: zipfile.ZipFile, file: IO[bytes], size: int) -> None:
        self._archive, self._file, self._size = archive, file, size
        self._members: dict[str, zipfile.ZipInfo] = {}
        self._start: dict[str, tuple[int, bool]] = {}
        self.fields, self.pairs, self._followed = {}, {}, {}
        for info in archive.infolist():
            name = info.filename.removesuffix(".npy")
            if name in self._members:
                raise ValueError(f"{name}: found twice, expected one member of that name")
            self._members[name] = info
            with blamed(name, "damaged or not .npy"):
                self._describe(name, info)

    def _describe(self, name: str, info: zipfile.ZipInfo) -> None:
        stored = info.compress_type == zipfile.ZIP_STORED
        if info.flag_bits & 1 or not (stored or info.compress_type == zipfile.ZIP_DEFLATED):
            raise ValueError("found an encrypted or unusual member, expected a stored or deflated one")
        most = info.compress_size * (1 if stored else _MOST_EXPANSION)
        if info.file_size > most or info.header_offset + info.compress_size > self._size:
            raise ValueError(f"found {info.file_size} bytes declared, expected at most {min(most, self._size * 1032)}")
        with self._archive.open(info) as stream:  # also compares the two names that a zip file holds
            if not info.filename.endswith(".npy"):
                return
            head = io.BytesIO(stream.read(_MOST_HEADER))
        shape, fortran, dtype = npy_header(head, info.file_size)
        start = head.tell()
        self.fields[name] = shape, dtype
        self._start[name] = start, fortran

    def _read(self, name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> Array:
        if dtype.hasobject:
            raise ValueError(f"{name}: found {dtype}, expected no Python objects")
        start, fortran = self._start[name]
        array = allocated(name, shape, dtype, "F" if fortran else "C")
        target = bytes_of(array)
        with blamed(name, "damaged"), self._archive.open(self._members[name]) as stream:
            stream.read(start)
            done = 0
            while done < target.size:
                part = stream.read(min(_CHUNK_BYTES, target.size - done))
                if not part:
                    raise ValueError(f"ends {target.size - done} bytes early")
                target[done : done + len(part)] = np.frombuffer(part, dtype=np.uint8)
                done += len(part)
            stream.read(1)  # the end: here zipfile compares the checksum
        return array

    def reads_rows(self, name: str) -> bool:
        return self._members[name].compress_type == zipfile.ZIP_STORED and not self._start[name][1]

    def _rows(self, name: str, first: int, shape: tuple[int, ...], dtype: np.dtype[Any]) -> Array:
        array = allocated(name, shape, dtype)
        self._file.seek(self._place(name) + self._start[name][0] + first * math.prod(shape[1:]) * dtype.itemsize)
        if (found := self._file.readinto(bytes_of(array))) != array.nbytes:  # type: ignore[attr-defined]
            raise ValueError(f"{name}: damaged: ends {array.nbytes - found} bytes early")
        return array

    def _place(self, name: str) -> int:
        """Where a member's bytes begin: behind its local header, whose name and extra field have lengths of their own."""
        info = self._members[name]
        self._file.seek(info.header_offset)
        head = self._file.read(30)
        return info.header_offset + 30 + int.from_bytes(head[26:28], "little") + int.from_bytes(head[28:30], "little")

    def _checksums(self, name: str) -> tuple[int, int] | None:
        self._file.seek(self._place(name))
        return zlib.crc32(self._file.read(self._start[name][0])), self._members[name].CRC


@contextlib.contextmanager
def _open_npz(file: IO[bytes]) -> Iterator[File]:
    size = file.seek(0, io.SEEK_END)
    try:
        opening = zipfile.ZipFile(_Bounded(file))
    except zipfile.BadZipFile as error:  # its directory stands at the end
        raise ValueError(f"damaged, or cut short while it was copied or written ({error})") from error
    with opening as archive:
        yield _Npz(archive, file, size)


def _write_npz(file: IO[bytes], fields: Mapping[str, Array | Streamed]) -> None:
    with zipfile.ZipFile(file, "w") as archive:
        for name, array in fields.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as stream:
                if not isinstance(array, Streamed):
                    np.lib.format.write_array(stream, array, allow_pickle=False)
                    continue
                header = {"descr": array.dtype.str, "fortran_order": False, "shape": array.shape}
                np.lib.format.write_array_header_1_0(stream, header)
                for block in _blocks(array):
                    stream.write(block.data)


class _H5(File):
    def __init__(self, file: Any, size: int, names: Container[str] | None = None) -> None:
        self._file, self._size = file, size
        self.fields, self.pairs, self._followed = {}, {}, {}
        for name in file:
            if names is None or name in names:
                with blamed(name):
                    self._describe(name)

    def _describe(self, name: str) -> None:
        h5py = _h5py()
        if not isinstance(self._file.get(name, getlink=True), h5py.HardLink):
            raise ValueError("found a link, expected a dataset within the file")
        item = self._file[name]
        if not isinstance(item, h5py.Dataset) or item.shape is None:
            self.fields[name] = (0,), np.dtype(object)  # a group or an empty dataset: no field of ours looks like that
            return
        if item.is_virtual or item.external:
            raise ValueError("found samples kept in other files, expected them within this one")
        properties = item.id.get_create_plist()
        filters = {properties.get_filter(i)[0] for i in range(properties.get_nfilters())}
        if not filters <= _SAFE_FILTERS:
            raise ValueError(f"found HDF5 filters {sorted(filters)}, expected some of {sorted(_SAFE_FILTERS)}")
        text = h5py.check_string_dtype(item.dtype)
        if text is not None and text.length is None:
            self.fields[name] = item.shape, np.dtype("U")
            return
        stored, declared = item.id.get_storage_size(), math.prod(item.shape) * item.dtype.itemsize
        most = stored * (_MOST_EXPANSION if filters & {1, 32000} else 1)
        if declared > most or stored > self._size:
            raise ValueError(f"found {declared} bytes declared and {stored} stored, expected all of them stored")
        if item.chunks is not None and declared:
            count = math.prod(-(-n // k) for n, k in zip(item.shape, item.chunks, strict=True))
            large = math.prod(item.chunks) * item.dtype.itemsize > max(declared, _CHUNK_BYTES)
            if large or item.id.get_num_chunks() != count:
                raise ValueError(f"found {item.id.get_num_chunks()} chunks of {item.chunks}, expected {count} that fit")
        self.fields[name] = item.shape, item.dtype

    def _read(self, name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> Array:
        item = self._file[name]
        if dtype.kind == "U":  # of a length that only its bytes tell
            with blamed(name, "damaged"):
                return np.asarray(item[()])
        array = allocated(name, shape, dtype)
        with blamed(name, "damaged"):
            if array.size:
                item.read_direct(array)
            if (kept := self._checksums(name)) is not None and zlib.crc32(bytes_of(array).data) != kept[1]:
                raise ValueError("found other bytes than were written, by their CRC-32")
        return array

    def _rows(self, name: str, first: int, shape: tuple[int, ...], dtype: np.dtype[Any]) -> Array:
        array = allocated(name, shape, dtype)
        with blamed(name, "damaged"):
            if array.size:
                self._file[name].read_direct(array, np.s_[first : first + shape[0]])
        return array

    def _checksums(self, name: str) -> tuple[int, int] | None:
        attributes = self._file[name].attrs
        if _CHECKSUM not in attributes:
            return None
        kept = attributes.get_id(_CHECKSUM)
        if kept.shape not in ((), (1,)) or kept.dtype.kind != "u":
            raise ValueError(f"found {kept.dtype} of shape {kept.shape} for {_CHECKSUM}, expected a whole number")
        return 0, int(np.asarray(attributes[_CHECKSUM]).item())


@contextlib.contextmanager
def _open_h5(file: IO[bytes]) -> Iterator[File]:
    with _h5py().File(file.name, "r") as opened:
        yield _H5(opened, file.seek(0, io.SEEK_END))


class _Netcdf(_H5):
    """NetCDF-4, which is HDF5: attributes that are one number or text are fields beside the variables, as in a Zarr store."""

    def __init__(self, file: Any, size: int) -> None:
        super().__init__(file, size)
        self._values: dict[str, Array] = {}
        for name in file.attrs:
            with blamed(name):
                kept = file.attrs.get_id(name)
                if name.startswith("_") or kept.dtype.kind not in "Sfiu" or math.prod(kept.shape or ()) != 1:
                    continue  # the library's own, and what no field of ours looks like
                if kept.dtype.itemsize > size or name in self.fields:
                    raise ValueError(f"found an attribute of {kept.dtype.itemsize} bytes, expected a short one of its own name")
                value = np.asarray(file.attrs[name]).reshape(())
                self._values[name] = np.asarray(value.item().decode()) if value.dtype.kind == "S" else value
        self.header = {name: value.item() for name, value in self._values.items()}
        self.fields |= {name: (value.shape, value.dtype) for name, value in self._values.items()}

    def _read(self, name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> Array:
        return self._values[name] if name in self._values else super()._read(name, shape, dtype)


@contextlib.contextmanager
def opened_netcdf(file: IO[bytes]) -> Iterator[_Netcdf]:
    """The variables of a NetCDF-4 file, by h5py."""
    with _h5py().File(file.name, "r") as opened:
        yield _Netcdf(opened, file.seek(0, io.SEEK_END))


class Groups:
    """The groups of an open .h5 file; nothing outside the file is followed."""

    def __init__(self, file: Any, size: int) -> None:
        self._file, self._size = file, size

    def names(self) -> list[str]:
        """What lies in the file's root."""
        return list(self._file)

    def group(self, path: str, names: Container[str] | None = None) -> File:
        """The arrays of one group, "" for the root; of these `names`, where they are given."""
        h5py = _h5py()
        found = self._file
        for part in filter(None, path.split("/")):
            if not isinstance(found.get(part, getlink=True), h5py.HardLink) or not isinstance(found[part], h5py.Group):
                raise ValueError(f"{path}: missing, expected a group")
            found = found[part]
        return _H5(found, self._size, names)

    def text(self, attribute: str) -> str | None:
        """An attribute of the root, where it is one string."""
        if attribute not in self._file.attrs:
            return None
        value = np.asarray(self._file.attrs[attribute]).reshape(-1)
        if value.size != 1 or not isinstance(value[0], str | bytes):
            return None
        return value[0].decode("utf-8", "replace") if isinstance(value[0], bytes) else str(value[0])


@contextlib.contextmanager
def opened_groups(file: IO[bytes]) -> Iterator[Groups]:
    """The groups of an .h5 file."""
    with _h5py().File(file.name, "r") as opened:
        yield Groups(opened, file.seek(0, io.SEEK_END))


class _Pages(io.RawIOBase):
    """A file in memory that keeps the pages written to: the bytes of arrays that HDF5 makes room for take none."""

    SIZE = 4096

    def __init__(self) -> None:
        self.pages: dict[int, bytearray] = {}
        self._at = self._end = 0

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        self._at = offset + (0, self._at, self._end)[whence]
        return self._at

    def _pieces(self, size: int) -> Iterator[tuple[int, int, slice]]:
        """Of the next `size` bytes: which page, from where on in it, and where among the bytes."""
        done = 0
        while done < size:
            page, start = divmod(self._at, self.SIZE)
            count = min(self.SIZE - start, size - done)
            yield page, start, slice(done, done + count)
            done += count
            self._at += count

    def readinto(self, buffer: Any) -> int:
        view = memoryview(buffer).cast("B")
        for page, start, place in self._pieces(len(view)):
            count = place.stop - place.start
            view[place] = self.pages[page][start : start + count] if page in self.pages else bytes(count)
        return len(view)

    def write(self, data: Any) -> int:
        view = memoryview(data).cast("B")
        for page, start, place in self._pieces(len(view)):
            kept = self.pages.setdefault(page, bytearray(self.SIZE))
            kept[start : start + place.stop - place.start] = view[place]
        self._end = max(self._end, self._at)
        return len(view)

    def truncate(self, size: int | None = None) -> int:
        self._end = self._at if size is None else size
        return self._end


def _write_h5(file: IO[bytes], fields: Mapping[str, Array | Streamed]) -> None:
    h5py = _h5py()
    arrays: dict[str, Array | Streamed] = {}
    checks = {}
    for name, array in fields.items():
        if array.dtype.kind == "U" and not isinstance(array, Streamed):
            encoded = str(array[()]).encode()
            kind = h5py.string_dtype("utf-8", max(1, len(encoded)))
            array = np.array(encoded if len(encoded) <= _COMPACT_BYTES else [encoded], dtype=kind)
        arrays[name] = array
        if array.ndim and array.size:
            checks[name] = 0
            for block in _blocks(array):
                checks[name] = zlib.crc32(block.data, checks[name])
    pages, places, size = _uninterrupted(lambda: _laid_out(arrays, checks))
    file.truncate(size)
    for number, page in sorted(pages.items()):
        file.seek(number * _Pages.SIZE)
        file.write(page[: size - number * _Pages.SIZE])
    for name, place in places.items():
        file.seek(place)
        for block in _blocks(arrays[name]):
            file.write(block.data)


def _laid_out(
    arrays: Mapping[str, Array | Streamed], checks: Mapping[str, int]
) -> tuple[dict[int, bytearray], dict[str, int], int]:
    """An HDF5 file without the bytes of those arrays that `checks` has: its pages, those arrays' places, and its length."""
    h5py, pages, places = _h5py(), _Pages(), {}
    # from version 1.8 of the format on, all metadata carry checksums; the bounds keep the file readable from 1.10 on
    with h5py.File(pages, "w", libver=("v110", "v110")) as made:
        for name, array in arrays.items():
            layout = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
            layout.set_layout(h5py.h5d.CONTIGUOUS if name in checks else h5py.h5d.COMPACT)
            layout.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
            layout.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
            kind, space = h5py.h5t.py_create(array.dtype, logical=True), h5py.h5s.create_simple(array.shape)
            item = h5py.h5d.create(made.id, name.encode(), kind, space, layout)
            if name in checks:
                h5py.Dataset(item).attrs.create(_CHECKSUM, checks[name], dtype="<u4")
                places[name] = item.get_offset()
            else:
                item.write(h5py.h5s.ALL, h5py.h5s.ALL, array)
        made.flush()
        size = made.id.get_filesize()
    return pages.pages, places, size


def _uninterrupted(work: Callable[[], Any]) -> Any:
    """The result of milliseconds of work in a thread of its own: HDF5 makes another error of a Ctrl-C within its callbacks.

    Waited for by a bare lock: a Ctrl-C within the conditions of `threading` may leave them in an error of their own.
    """
    outcome: list[tuple[Any, BaseException | None]] = []
    finished = _thread.allocate_lock()
    finished.acquire()

    def run() -> None:
        try:
            outcome.append((work(), None))
        except BaseException as error:
            outcome.append((None, error))
        finally:
            finished.release()

    try:
        _thread.start_new_thread(run, ())
    except RuntimeError:  # Python ends and starts no more
        run()
    finished.acquire()
    result, error = outcome[0]
    if error is not None:
        raise error
    return result


def _blocks(array: Array | Streamed) -> Iterator[Array]:
    """The entries in order of C, some at a time, copied only where they do not lie so."""
    if isinstance(array, Streamed):
        for block in array.blocks():
            yield bytes_of(np.ascontiguousarray(block, array.dtype))
    elif array.flags.c_contiguous:
        flat = bytes_of(array)
        yield from (flat[at : at + _BLOCK_BYTES] for at in range(0, flat.size, _BLOCK_BYTES))
    else:
        most = max(_BLOCK_BYTES // array.itemsize, 1)
        yield from np.nditer(array, flags=["external_loop", "buffered"], buffersize=most, order="C")


def _h5py() -> Any:
    try:
        import h5py
    except ImportError:
        raise _checks.optional("h5py", "hdf5") from None
    return h5py

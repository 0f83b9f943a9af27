"""Echoes: the recorded samples of every ping and channel with the geometry and sampling they need.

This is the border where navigation and sampling are checked; the engines trust it, so navigation is copied. Samples are kept
as given (any stride or byte order, never copied) and looked at only when used, so a record may hold non-finite samples.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from pysas import _checks
from pysas._checks import ComplexArray, FloatArray
from pysas.model.beam import Beam
from pysas.model.pulse import LFM

# A term counts up to EDGE samples beyond its record's ends, where the trace is read at the end: far more than places in float64
# are rounded by, so that pixels put on an edge count whatever the rounding, and far less than anything physical.
# `reference.exact` states the same rule; `beam.EDGE_ANGLE` is its like.
EDGE = 1e-4


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Echoes:
    """Samples of a survey with their geometry (SI units).

    Parameters
    ----------
    data : (ping, channel, sample) or (ping, sample) complex64 or complex128
        Complex base-band samples: a point at two-way travel time tau contributes p(t - tau) exp(-2j pi fc tau).
    fs, fc : float
        Sample rate and demodulation frequency, Hz.
    tx : (ping, 3)
        Transmitter at the instant of transmission, m.
    rx : (ping, channel, 3), or (ping, 3) for (ping, sample) data
        Receivers at the instant of transmission, m.
    c : float or (ping,)
        Sound speed, m/s: one, or each ping's own, by which its echoes travelled.
    t0 : float or (ping,)
        Time of sample 0 after the start of transmission, s.
    velocity : (ping, 3) or (ping, channel, 3), optional
        Receivers' velocity until the echo arrives, m/s. None: stop-and-hop.
    bandwidth : float, optional
        Two-sided occupied bandwidth of `data` about fc, Hz. Default: the pulse's, else fs/1.1.
    pulse : LFM or (sample,) complex, optional
        Transmitted pulse, or its base-band waveform at rate fs from t = 0; what `compress` needs.
    compressed : bool
        True: an echo peaks at its travel time. False: raw, an echo begins there.
    beam : Beam, optional
        None: omnidirectional.
    valid : (ping, 2) or (ping, channel, 2) whole numbers, optional
        First and last sample that were recorded, 0 <= first <= last < sample; last = first - 1: nothing was. Samples outside
        are not looked at, whatever they hold (NaN included): the trace counts as one cropped to these, begun at t0 + first/fs.
        None: all samples.
    ping_time : (ping,), optional
        Time of each transmission, s.
    attrs : mapping, optional
        Anything else (title, source, truth).

    Raises
    ------
    ValueError, TypeError
        Wrong shape, dtype, unit or non-finite navigation; names the argument, and the first ping and channel.
    """

    data: ComplexArray = field(kw_only=False)
    fs: float
    fc: float
    tx: FloatArray
    rx: FloatArray
    c: float | FloatArray = 1500.0
    t0: float | FloatArray = 0.0
    velocity: FloatArray | None = None
    bandwidth: float | None = None
    pulse: LFM | npt.NDArray[np.complexfloating[Any, Any]] | None = None
    compressed: bool = True
    beam: Beam | None = None
    valid: npt.NDArray[np.int64] | None = None
    ping_time: FloatArray | None = None
    attrs: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._validate()

    @_checks.usual_errors
    def _validate(self) -> None:
        def put(name: str, value: Any) -> None:
            object.__setattr__(self, name, value)

        put("data", _checks.samples("data", self.data, (2, 3)))
        for name in ("fs", "fc"):
            put(name, _checks.number(name, getattr(self, name), positive=True))
        ping, three = self.data.shape[0], self.data.ndim == 3
        receivers = (ping, self.data.shape[1], 3) if three else (ping, 3)
        self._upright()
        put("tx", _checks.reals("tx", self.tx, [(ping, 3)], ("ping",)))
        put("rx", _checks.reals("rx", self.rx, [receivers], ("ping", "channel") if three else ("ping",)))
        put("c", _speeds(self.c, ping))
        scalar = _checks.array_like("t0", self.t0).ndim == 0
        put("t0", _checks.number("t0", self.t0) if scalar else _checks.reals("t0", self.t0, [(ping,)], ("ping",)))
        if self.velocity is not None:
            shapes = [(ping, 3), receivers] if three else [(ping, 3)]
            labels = ("ping", "channel") if _checks.array_like("velocity", self.velocity).ndim == 3 else ("ping",)
            put("velocity", _checks.reals("velocity", self.velocity, shapes, labels))
            speed = float(np.max(np.linalg.norm(self.velocity, axis=-1)))
            most = float(np.min(self.speeds)) / 10
            if speed >= most:
                raise ValueError(f"velocity: {speed:g} m/s: expected below a tenth of the sound speed, {most:g} m/s")
        self._validate_pulse(put)
        if self.beam is not None:
            if not isinstance(self.beam, Beam):
                raise TypeError(f"beam={self.beam!r}: expected a pysas.Beam or None")
            self.beam.require_pings(ping)
        if self.valid is not None:
            put("valid", _windows(self.valid, self.data.shape))
        if not isinstance(self.compressed, bool | np.bool_):
            raise TypeError(f"compressed={self.compressed!r}: expected True or False")
        put("compressed", bool(self.compressed))
        if self.ping_time is not None:
            put("ping_time", _checks.reals("ping_time", self.ping_time, [(ping,)], ("ping",)))
        if self.attrs is not None and not isinstance(self.attrs, Mapping):
            raise TypeError(f"attrs={self.attrs!r}: expected a mapping")
        put("attrs", dict(self.attrs or {}))

    def _upright(self) -> None:
        """Data whose axes are in another order are told by the number of transmitters, before tx is blamed."""
        shape, tx = self.data.shape, _checks.array_like("tx", self.tx).shape
        if len(tx) == 2 and tx[1] == 3 and tx[0] != shape[0] and tx[0] in shape[1:]:
            wanted = "(ping, sample)" if len(shape) == 2 else "(ping, channel, sample)"
            axis = shape.index(tx[0], 1)
            raise ValueError(
                f"data: shape {shape} beside {tx[0]} transmitters: expected {wanted}: is axis {axis} that of pings?"
            )

    def _validate_pulse(self, put: Any) -> None:
        if self.pulse is not None and not isinstance(self.pulse, LFM):
            pulse = _checks.samples("pulse", self.pulse, (1,))
            if not np.all(np.isfinite(pulse)):
                raise ValueError("pulse: expected finite samples")
            put("pulse", _checks.own(pulse, pulse.dtype.newbyteorder("=")))
        if self.bandwidth is not None:
            put("bandwidth", _checks.number("bandwidth", self.bandwidth, positive=True))
        elif isinstance(self.pulse, LFM):
            put("bandwidth", self.pulse.occupied_bandwidth + 2 * abs(self.pulse.fc - self.fc))
        else:
            put("bandwidth", self.fs / 1.1)

    @property
    def n_ping(self) -> int:
        """Number of pings."""
        return int(self.data.shape[0])

    @property
    def n_channel(self) -> int:
        """Number of receiver channels."""
        return int(self.data.shape[1]) if self.data.ndim == 3 else 1

    @property
    def n_sample(self) -> int:
        """Samples per trace."""
        return int(self.data.shape[-1])

    @property
    def dtype(self) -> np.dtype[Any]:
        """complex64 or complex128, native byte order."""
        return np.dtype(np.complex64 if self.data.dtype.itemsize == 8 else np.complex128)

    @property
    def occupied_bandwidth(self) -> float:
        """`bandwidth`, always a number, Hz."""
        if self.bandwidth is None:
            raise _checks.InternalError("bandwidth: not set")
        return self.bandwidth

    @property
    def traces(self) -> ComplexArray:
        """View (ping, channel, sample) of the data."""
        return self.data if self.data.ndim == 3 else self.data[:, None, :]

    @property
    def receivers(self) -> FloatArray:
        """View (ping, channel, 3) of the receivers, m."""
        return self.rx if self.data.ndim == 3 else self.rx[:, None, :]

    @property
    def receiver_velocity(self) -> FloatArray | None:
        """(ping, channel, 3) view of the velocity, m/s, or None."""
        if self.velocity is None:
            return None
        velocity = self.velocity if self.velocity.ndim == 3 else self.velocity[:, None, :]
        return np.broadcast_to(velocity, (self.n_ping, self.n_channel, 3))

    @property
    def start_time(self) -> FloatArray:
        """(ping,) time of sample 0, s."""
        return np.broadcast_to(np.asarray(self.t0, dtype=np.float64), (self.n_ping,))

    @property
    def speeds(self) -> FloatArray:
        """(ping,) sound speeds, m/s."""
        return np.broadcast_to(np.asarray(self.c, dtype=np.float64), (self.n_ping,))

    @property
    def mean_speed(self) -> float:
        """Mean of the pings' sound speeds, m/s; their own where they have one."""
        return self.c if isinstance(self.c, float) else float(np.mean(self.c))

    @property
    def speed(self) -> float:
        """The one sound speed of all pings, m/s, for algorithms that know no other.

        Raises
        ------
        ValueError
            Pings of different speeds.
        """
        if isinstance(self.c, float):
            return self.c
        other = np.flatnonzero(self.c != self.c[0])
        if other.size:
            raise ValueError(
                f"echoes: c={self.c[other[0]]:.9g} m/s at ping {other[0]}, {self.c[0]:.9g} m/s at ping 0: expected one speed "
                "of all pings: pysas.backproject, ffbp and focus take a speed a ping; or echoes.replace(c=echoes.mean_speed)"
            )
        return float(self.c[0])

    @property
    def windows(self) -> npt.NDArray[np.int64]:
        """(ping, channel, 2) first and last sample that were recorded of each trace: `valid`, or all."""
        valid = np.array([0, self.n_sample - 1]) if self.valid is None else self.valid
        valid = valid[:, None] if valid.ndim == 2 else valid
        return np.broadcast_to(valid, (self.n_ping, self.n_channel, 2))

    def whole(self) -> Echoes:
        """The same with zeros in place of all samples outside `valid`, which is None then: a copy where `valid` is given."""
        if self.valid is None:
            return self
        data = np.array(self.data, dtype=self.dtype)
        at, (first, last) = np.arange(self.n_sample), np.moveaxis(self.windows, -1, 0)
        outside = (at < first[..., None]) | (at > last[..., None])
        data[outside.reshape(data.shape)] = 0
        return self.replace(data=data, valid=None)

    @property
    def swath(self) -> tuple[float, float]:
        """Slant ranges that the record covers, m; where sound speeds differ, the least and the largest of any ping."""
        half, last = self.speeds / 2, (self.n_sample - 1) / self.fs
        return float(np.min(half * self.start_time)), float(np.max(half * (self.start_time + last)))

    @property
    def range_resolution(self) -> float:
        """-3 dB width in slant range of an unweighted flat band, 0.886 c/(2 bandwidth), m; c the pings' mean."""
        return 0.886 * self.mean_speed / (2 * self.occupied_bandwidth)

    @_checks.usual_errors
    def phase_centre_spacing(self) -> tuple[float, float]:
        """Median and largest gap (m) between phase centres (tx + rx)/2 along the track, all channels together."""
        centres = (self.tx[:, None, :] + self.receivers) / 2
        mean = centres.mean(axis=1)
        if self.n_ping > 1:
            along = np.gradient(mean, axis=0)
            norm = np.linalg.norm(along, axis=1, keepdims=True)
            tangent = np.divide(along, norm, out=np.zeros_like(along), where=norm > 0)
        else:
            tangent = np.zeros_like(mean)
            spread = centres[0] - mean[0]
            far = spread[np.argmax(np.linalg.norm(spread, axis=1))]
            tangent[0] = far / max(float(np.linalg.norm(far)), 1e-300)
        arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(mean, axis=0), axis=1))])
        offset = np.einsum("pcx,px->pc", centres - mean[:, None], tangent)
        gaps = np.diff(np.sort((arc[:, None] + offset).ravel()))
        gaps = gaps[gaps > 1e-6]
        if gaps.size == 0:
            return 0.0, 0.0
        return float(np.median(gaps)), float(gaps.max())

    def warnings(self) -> list[str]:
        """What a person should know before imaging: sampling margins that are too small, one line each."""
        found = []
        margin = self.fs / self.occupied_bandwidth
        if margin < 1.1:
            found.append(f"fs is {margin:.3g} x the bandwidth {self.occupied_bandwidth:g} Hz: below 1.1, data alias in range")
        if self.beam is not None and self.n_ping > 1:
            median, largest = self.phase_centre_spacing()
            length = self.beam.length
            for gap, label in ((median, "median"), (largest, "largest")):
                if gap > length / 2 * (1 + 1e-9):
                    found.append(f"along-track under-sampled: {label} spacing {gap:.4g} m > D/2 = {length / 2:.4g} m")
                    break
                if gap > length / 4 * (1 + 1e-9):
                    found.append(
                        f"along-track spacing ({label} {gap:.4g} m) > D/4 = {length / 4:.4g} m: main lobe's edge aliases"
                    )
                    break
        if self.n_ping > 1 and float(np.max(np.linalg.norm(np.diff(self.tx, axis=0), axis=1))) == 0:
            found.append("the track does not move: no along-track resolution")
        return found

    def replace(self, **changes: Any) -> Echoes:
        """A copy with some fields replaced, validated again; samples are shared, not copied."""
        fields = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        fields.update(changes)
        return Echoes(fields.pop("data"), **fields)

    def __getitem__(self, pings: slice | int | npt.ArrayLike) -> Echoes:
        """Some of the pings, with all that belongs to each: echoes[10:200], echoes[::2], echoes[5], echoes[good].

        Parameters
        ----------
        pings : slice, int, or (n,) array of whole numbers or booleans
            Samples of a slice are shared, not copied; an int keeps one ping.

        Raises
        ------
        IndexError, TypeError
            A ping that is not there; another index.
        ValueError
            No ping is left.
        """
        which = _chosen("pings", pings, self.n_ping)
        changes: dict[str, Any] = {name: value[which] for name, value in self._arrays()}
        if self.beam is not None:
            own = {name: getattr(self.beam, name) for name in ("boresight", "axis")}
            own = {name: value[which] for name, value in own.items() if value is not None and value.ndim > 1}
            changes["beam"] = dataclasses.replace(self.beam, **own) if own else self.beam
        return self.replace(**changes)

    def channels(self, which: slice | int | npt.ArrayLike) -> Echoes:
        """Some of the receivers of all pings, chosen as pings are: echoes.channels(slice(0, 4)), echoes.channels([0, 5])."""
        chosen = _chosen("which", which, self.n_channel)
        if self.data.ndim == 2:
            np.zeros(1)[chosen]  # which has the one channel or raises
            return self
        return self.replace(**{name: value[:, chosen] for name, value in self._arrays() if value.ndim > 2})

    def _arrays(self) -> list[tuple[str, npt.NDArray[Any]]]:
        """Fields whose first axis is the ping, by name; those of three axes have the channel next."""
        found = [(f.name, getattr(self, f.name)) for f in dataclasses.fields(self) if f.name != "pulse"]
        return [(name, value) for name, value in found if isinstance(value, np.ndarray) and value.ndim > 0]

    def _spoken_speed(self) -> str:
        low, high = float(np.min(self.c)), float(np.max(self.c))
        return f"{low:g}" if low == high else f"{low:g} to {high:g}"

    def __repr__(self) -> str:
        median, largest = self.phase_centre_spacing()
        near, far = self.swath
        track = float(np.sum(np.linalg.norm(np.diff(self.tx, axis=0), axis=1)))
        motion = "moving receivers" if self.velocity is not None else "stop-and-hop"
        lines = [
            f"Echoes: {self.n_ping} pings x {self.n_channel} channels x {self.n_sample} samples, {self.dtype}, "
            f"{'range-compressed' if self.compressed else 'raw'}",
            f"  sampling   fs {self.fs:g} Hz = {self.fs / self.occupied_bandwidth:.3g} x bandwidth "
            f"{self.occupied_bandwidth:g} Hz, fc {self.fc:g} Hz, c {self._spoken_speed()} m/s",
            f"  swath      {near:.2f} to {far:.2f} m slant range, resolution {self.range_resolution * 100:.3g} cm",
            f"  track      {track:.3g} m, phase centres every {median:.3g} m (largest gap {largest:.3g} m), {motion}",
        ]
        if self.valid is not None:
            share = np.mean(self.windows[..., 1] - self.windows[..., 0] + 1) / self.n_sample
            lines.append(f"  valid      {100 * share:.4g} % of the samples were recorded")
        if self.pulse is not None:
            lines.append(f"  pulse      {self.pulse if isinstance(self.pulse, LFM) else f'{self.pulse.size} samples'}")
        if self.beam is not None:
            lines.append(f"  beam       {self.beam.describe()}")
        return "\n".join(lines + [f"  warning    {text}" for text in self.warnings()])


def _chosen(name: str, which: slice | int | npt.ArrayLike, count: int) -> slice | npt.NDArray[Any]:
    """An index of one axis, of `count`, that keeps the axis and something on it."""
    if isinstance(which, slice):
        if len(range(*which.indices(count))) == 0:
            raise ValueError(f"{name}={which}: none of {count} is left: expected some")
        return which
    if isinstance(which, tuple):
        raise TypeError(
            f"{name}={which!r:.60}: expected a slice, whole numbers or booleans of pings; receivers are chosen by channels()"
        )
    index = _checks.array_like(name, which)
    if index.dtype.kind not in "iub" or index.ndim > 1 or (index.dtype == np.bool_ and index.shape != (count,)):
        raise TypeError(f"{name}={which!r:.60}: expected a slice, whole numbers, or {count} booleans")
    index = np.flatnonzero(index) if index.dtype == np.bool_ else np.atleast_1d(index)
    if index.size == 0:
        raise ValueError(f"{name}={which!r:.60}: none of {count} is left: expected some")
    if index.min() < -count or index.max() >= count:
        raise IndexError(f"{name}={which!r:.60}: expected below {count}")
    return slice(int(index[0]) % count, int(index[0]) % count + 1) if index.size == 1 else index


def _speeds(c: Any, pings: int) -> float | FloatArray:
    """Sound speeds as they were given, one or (ping,), once they are finite numbers > 0."""
    if _checks.array_like("c", c).ndim == 0:
        return _checks.number("c", c, positive=True)
    speeds = _checks.reals("c", c, [(pings,)], ("ping",))
    if not np.all(speeds > 0):
        ping = int(np.argmin(speeds > 0))
        raise ValueError(f"c: {speeds[ping]:g} at ping {ping}: expected numbers > 0")
    return speeds


def _windows(valid: Any, shape: tuple[int, ...]) -> npt.NDArray[np.int64]:
    """First and last samples (ping, 2) or (ping, channel, 2) of data of this shape, once they lie within it."""
    array, n = _checks.array_like("valid", valid), shape[-1]
    if array.dtype.kind not in "iu":
        raise TypeError(f"valid: expected whole numbers, found dtype {array.dtype}")
    wanted = [(shape[0], 2)] + [(*shape[:2], 2)] * (len(shape) == 3)
    if array.shape not in wanted:
        raise ValueError(f"valid: expected shape {' or '.join(map(str, wanted))}, found {array.shape}")
    array = _checks.own(array, array.dtype)  # first: another thread may write to what was given
    first, last = array[..., 0], array[..., 1]
    if array.dtype.kind == "u":
        last = np.minimum(last, n).astype(np.int64)
        first = np.minimum(first, n).astype(np.int64)
    good = (first >= 0) & (first < n) & (last >= first - 1) & (last < n)
    if not good.all():
        index = tuple(int(i) for i in np.argwhere(~good)[0])
        where = ", ".join(f"{label} {i}" for label, i in zip(("ping", "channel"), index, strict=False))
        raise ValueError(
            f"valid: samples {array[index][0]} to {array[index][1]} at {where}: expected 0 <= first <= last <= {n - 1}, or "
            "last = first - 1 where nothing was recorded"
        )
    return _checks.own(array, np.int64)

"""Which mistakes `pysas check` names, on how many scenes: `python -m bench.mistakes` prints docs/check.md.

Each mistake is made with each of twenty simulated scenes and three files that this project did not make, where the data can
show it (`Mistake.shown` says where), and must be named in the words beside it; good data must be told nothing.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

import pysas
from bench.document import parser, write
from bench.mistake_scenes import SCENES, measured, survey

TIMES = 12  # the pass-band rate over that of base-band


def spoken(echoes):
    """What is not well: (name, state, text)."""
    return [(f.name, f.state, f.text) for f in pysas.inspect(echoes) if f.state != "ok"]


def rng(echoes):
    """The same for the same scene."""
    return np.random.default_rng([echoes.n_ping, echoes.n_channel, echoes.n_sample])


def with_data(echoes, data):
    return echoes.replace(data=np.ascontiguousarray(data, dtype=echoes.dtype))


def on_carrier(echoes, times):
    """Analytic pass-band samples at `times` the rate: band-limited interpolation, then the carrier."""
    n = echoes.n_sample
    spectra = np.fft.fft(echoes.traces, axis=-1)
    wide = np.zeros((*spectra.shape[:2], n * times), dtype=complex)
    wide[..., : n // 2], wide[..., -(n - n // 2) :] = spectra[..., : n // 2], spectra[..., n // 2 :]
    t = echoes.start_time[:, None, None] + np.arange(n * times) / (times * echoes.fs)
    data = np.fft.ifft(wide, axis=-1) * times * np.exp(2j * np.pi * (echoes.fc * t % 1))
    return data.reshape(*echoes.data.shape[:-1], -1)


def cast(echoes):
    few = cropped(echoes)
    return few.replace(data=on_carrier(few, TIMES).real.astype(few.dtype), fs=TIMES * few.fs)


def analytic(echoes):
    few = cropped(echoes)
    return few.replace(data=on_carrier(few, TIMES).astype(few.dtype), fs=TIMES * few.fs)


def cropped(echoes, pings=32):
    """Few pings, of what is twelve times as long otherwise."""
    part = slice(0, min(pings, echoes.n_ping))
    more = {
        name: getattr(echoes, name)[part] for name in ("tx", "rx", "velocity", "ping_time") if getattr(echoes, name) is not None
    }
    if np.ndim(echoes.t0):
        more["t0"] = echoes.t0[part]
    return echoes.replace(data=echoes.data[part], **more)


def aliased(echoes):
    return with_data(echoes, on_carrier(echoes, 1))


def swapped(echoes):
    return with_data(echoes, echoes.data.imag + 1j * echoes.data.real)


def down(echoes):
    return echoes.replace(pulse=replace(echoes.pulse, bandwidth=-echoes.pulse.bandwidth))


def in_turn(echoes):
    """Up and down sweeps in turn: the spectra of every other ping turned from one sweep's phase to the other's."""
    n = 2 * echoes.n_sample
    pulse, other = (p.spectrum(np.fft.fftfreq(n, 1 / echoes.fs)) for p in (echoes.pulse, down(echoes).pulse))
    turn = other * np.conj(pulse) / np.maximum(np.abs(other * pulse), 1e-300)
    data = echoes.data.copy()
    data[::2] = np.fft.ifft(np.fft.fft(data[::2], n, axis=-1) * turn, axis=-1)[..., : echoes.n_sample]
    return with_data(echoes, data)


def shuffled(echoes):
    return with_data(echoes, echoes.data[rng(echoes).permutation(echoes.n_ping)])


def other_receivers(echoes):
    """Two boards, one after the other, of receivers that take turns in the array."""
    order = np.r_[np.arange(0, echoes.n_channel, 2), np.arange(1, echoes.n_channel, 2)]
    return with_data(echoes, echoes.data[:, order])


def pings_as_channels(echoes):
    n = echoes.n_channel
    few = cropped(echoes, n)
    return with_data(few, few.data.swapaxes(0, 1))


def pings_as_samples(echoes):
    n = min(echoes.n_ping, echoes.n_sample)
    few = cropped(echoes, n)
    energy = np.cumsum(np.mean(np.abs(few.traces) ** 2, axis=(0, 1)))
    first = int(np.argmax(energy[n:] - energy[:-n])) if few.n_sample > n else 0
    data = few.traces[:, 0, first : first + n]
    flat = few.replace(data=data, rx=few.receivers[:, 0], velocity=None, t0=few.start_time + first / few.fs)
    return with_data(flat, flat.data.T)


def degrees(echoes):
    metres = 111320.0
    turned = [
        np.stack([59.9 + p[..., 1] / metres, 10.7 + p[..., 0] / metres / np.cos(np.radians(59.9)), p[..., 2]], axis=-1)
        for p in (echoes.tx, echoes.rx)
    ]
    return echoes.replace(tx=turned[0], rx=turned[1])


def single(echoes):
    offset = np.array([6.1e5, 6.64e6, 0.0])
    return echoes.replace(tx=(echoes.tx + offset).astype(np.float32), rx=(echoes.rx + offset).astype(np.float32))


def lever(echoes):
    """Positions of a reference point 1.2 m from the sonar, on a platform that yaws and rolls by 3 degrees."""
    phase = np.arange(echoes.n_ping) / echoes.n_ping * 2 * np.pi
    yaw, roll = 0.05 * np.sin(2 * phase), 0.05 * np.cos(3 * phase)
    along, across, up = -1.0, 0.3, -0.5
    heading = np.arctan2(*np.gradient(echoes.tx, axis=0)[:, 1::-1].T) + yaw
    side = across * np.cos(roll) - up * np.sin(roll)
    arm = np.stack([np.cos(heading) * along - np.sin(heading) * side, np.sin(heading) * along + np.cos(heading) * side,
                    across * np.sin(roll) + up * np.cos(roll)], axis=1)  # fmt: skip
    scale = echoes.c / echoes.fc / 0.015  # of radar too
    return echoes.replace(tx=echoes.tx - scale * arm, rx=echoes.rx - scale * (arm if echoes.rx.ndim == 2 else arm[:, None]))


def channel(value):
    def made(echoes):
        data = echoes.data.copy()
        data[:, echoes.n_channel // 2] = value(echoes)
        return with_data(echoes, data)

    return made


def noise(echoes, decibels):
    shape = (echoes.n_ping, echoes.n_sample)
    random = rng(echoes)
    level = np.sqrt(np.mean(np.abs(echoes.data) ** 2) / 2) * 10 ** (decibels / 20)
    return level * (random.standard_normal(shape) + 1j * random.standard_normal(shape))


def limited(echoes):
    level = np.quantile(np.abs(echoes.data.real), 0.97)
    return np.clip(echoes.data.real, -level, level) + 1j * np.clip(echoes.data.imag, -level, level)


def varied(echoes):
    return limited(echoes) * (1 + np.arange(echoes.n_sample) / 100.0)


def stepped(echoes):
    gain = np.where(np.arange(echoes.n_ping) // 16 % 2, 4.0, 1.0)
    return with_data(echoes, echoes.data * gain.reshape(-1, *[1] * (echoes.data.ndim - 1)))


def blanked(echoes):
    data = echoes.data.copy()
    loud = np.argmax(np.mean(np.abs(echoes.traces) ** 2, axis=(0, 1)))
    first = int(np.clip(loud - 30, 1, echoes.n_sample - 62))
    data[::3, ..., first : first + 60] = 0
    return with_data(echoes, data)


def late(echoes):
    data = np.zeros_like(echoes.data)
    data[..., 37:] = echoes.data[..., :-37]
    return with_data(echoes, data)


def tone(echoes):
    pulse = echoes.pulse
    f = 0.5 * (abs(pulse.bandwidth) / 2 + echoes.fs / 2)
    level = np.sqrt(np.mean(np.abs(echoes.data) ** 2))
    return with_data(echoes, echoes.data + level * np.exp(2j * np.pi * f * np.arange(echoes.n_sample) / echoes.fs))


def offset(echoes):
    return with_data(echoes, echoes.data + (0.8 + 0.6j) * np.sqrt(np.mean(np.abs(echoes.data) ** 2)))


@dataclass(frozen=True)
class Mistake:
    """What is done wrong, to samples before they are compressed or (`after`) as they are checked.

    Attributes
    ----------
    make : echoes -> echoes
        Or a dict of what `survey` does otherwise.
    says : str
        Regular expression that one finding's name and text must match.
    shown : Case -> bool
        Where the data can show it.
    where : str
        The same in words.
    """

    name: str
    make: Callable | dict
    says: str
    shown: Callable = lambda case: True
    where: str = "everywhere"
    after: bool = False


def has_pulse(case):
    return case.echoes.pulse is not None


def raw(case):
    return has_pulse(case) and not case.compressed


def array(case):
    return case.echoes.n_channel > 1


def bent(case):
    return array(case) or (case.path == "sway" and followed(case))


def followed(case):
    """An echo can be followed over 20 pings, and fits."""
    good = pysas.inspect(case.formed(case.echoes))
    return any(f.name == "positions" and "echoes followed fit" in f.text for f in good)


def simulated(case):
    return case.scene is not None


RAW, PULSE = "raw samples", "where the pulse is given"
MISTAKES = (
    Mistake("pass-band samples cast to complex", cast, "base-band.*cast to complex", has_pulse, PULSE),
    Mistake("analytic samples not demodulated", analytic, "band:.*not demodulated", raw, RAW),
    Mistake("the same, aliased by decimation", aliased, "band:.*not demodulated", raw, RAW),
    Mistake("conjugate data", lambda e: with_data(e, e.data.conj()), "conjugate", has_pulse, PULSE),
    Mistake("I and Q swapped", swapped, "I and Q swapped", has_pulse, PULSE),
    Mistake("wrong sign of the sweep", down, "sweep's sign", has_pulse, PULSE),
    Mistake("up and down sweeps in turn, one pulse", in_turn, "in turn", has_pulse, PULSE),
    Mistake("pings shuffled", shuffled, "pings are shuffled"),
    Mistake("pings reversed", lambda e: with_data(e, e.data[::-1]), "in reverse order", bent, "arrays, bent tracks"),
    Mistake("receivers reversed", lambda e: with_data(e, e.data[:, ::-1]), "in reverse order", array, "arrays"),
    Mistake("receivers shuffled", other_receivers, "receivers are shuffled", array, "arrays"),
    Mistake(
        "pings and channels transposed", pings_as_channels, "transposed", lambda c: c.echoes.n_channel == 16, "16 receivers"
    ),
    Mistake("pings and samples transposed", pings_as_samples, "transposed", after=True),
    Mistake("degrees taken for metres", degrees, "degrees of latitude"),
    Mistake("UTM as float32", single, "positions are multiples of"),
    Mistake("lever arm forgotten", lever, "lever arm", followed, "where an echo can be followed"),
    Mistake("dead channel", channel(lambda e: 0), "dead channels", array, "arrays"),
    Mistake("stuck channel", channel(lambda e: 0.37), "stuck channels", lambda c: array(c) and raw(c), "arrays, raw"),
    Mistake("noisy channel, +20 dB", channel(lambda e: noise(e, 20)), "channels:.*dB from the others", array, "arrays"),
    Mistake("channel of noise alone", channel(lambda e: noise(e, 0)), "channels:.*echoes of its own", array, "arrays"),
    Mistake("clipping", lambda e: with_data(e, limited(e)), "clipping:", raw, RAW),
    Mistake("clipping before a gain with time", lambda e: with_data(e, varied(e)), "clipping:.*gain that varies", raw, RAW),
    Mistake("gain steps of 12 dB", stepped, "gain:.*step of"),
    Mistake("blanked gaps", blanked, "gaps of zeros", after=True),
    Mistake("a constant in I and Q", offset, "offset:"),
    Mistake(
        "phase centres that overlap", {"advance": 0.85}, "phase centres:.*ghosts", lambda c: array(c) and simulated(c), "arrays"
    ),
    Mistake(
        "start of record 37 samples late",
        late,
        "t0",
        lambda c: c.path != "circle" and followed(c),
        "lines, where an echo can be followed",
    ),
    Mistake("energy beyond the declared band", lambda e: e.replace(bandwidth=e.bandwidth / 2, pulse=None), "band:", after=True),
    Mistake("interference beside the band", tone, "band:.*interference", raw, RAW),
    Mistake(
        "motion during a long pulse",
        {"duration": 10e-3, "speed": 10.0},
        "Doppler:",
        lambda c: simulated(c) and c.path == "line",
        "straight tracks",
    ),
)


@dataclass(frozen=True, eq=False)
class Case:
    """A good survey: as it was recorded, and in which form it is checked."""

    name: str
    path: str
    bed: str
    compressed: bool
    echoes: pysas.Echoes
    scene: object = None

    def formed(self, echoes):
        """In the form that is checked."""
        return pysas.compress(echoes) if self.compressed and not echoes.compressed else echoes

    def with_mistake(self, mistake):
        if isinstance(mistake.make, dict):
            return self.formed(survey(self.scene, **mistake.make))
        if mistake.after:
            return mistake.make(self.formed(self.echoes))
        return self.formed(mistake.make(self.echoes))


def cases(seed=0, simulated=None):
    """All good surveys, or those of some scenes alone."""
    for scene in SCENES if simulated is None else simulated:
        yield Case(scene.name, scene.path, scene.bed, scene.compressed, survey(scene, seed), scene)
    if simulated is None:
        for name, echoes in measured().items():
            path = {"stripmap_perturbed": "sway", "circular": "circle", "gotcha": "circle"}[name]
            yield Case(name, path, "points", echoes.compressed, echoes)


def named(mistake, echoes):
    """Whether it is named, and all that is said."""
    said = spoken(echoes)
    return any(re.search(mistake.says, f"{name}: {text}") for name, _, text in said), said


HEAD = """# What `pysas check` sees

Written by `python -m bench.mistakes --write docs/check.md`. Every mistake is made with every scene that can show it: twenty
simulated ones (lines, swaying lines and arcs; 1, 6 and 16 receivers; points, speckle, both, rippled sand; 20 to -5 dB; raw and
compressed; as low as a third of the nearest range) and, where PYSAS_DATA names their folder, two surveys simulated by another
program and a measured radar scene. `named`: a finding that is not ok says it.

"""
TAIL = """
`FAIL` ends with exit code 1: no image of such data can be right. `warn`: an image is worse than it could be, or may be.
`pysas image` prints both before it begins. In Python: `pysas.inspect(echoes)`.

## How

- Navigation, sampling, beam and pulse are checked by themselves, all samples are read once for the level, mean, largest value
  and constancy of every trace, and steps of gain are looked for where levels jump.
- At most 128 consecutive pings of 16 channels about the middle of the survey, at most 512 traces of 4096 samples, are looked at
  closely: circularity (sum x^2 / sum |x|^2: 1 for real samples), share of energy in the declared band against other bands as
  wide, kurtosis after the filter for the pulse and for its conjugate, coherence of all these traces with each other.
- Up to five echoes that stand out five times above their surroundings over 20 pings are followed through 256 pings of 4
  channels; a place is fitted to their delays and phases. Where none fits, the mistakes that would make one fit are tried.

Time: 30 ns a sample and about half a second beside it, up to two where a mistake of positions is looked for. The same file is
told the same every time. Pings shuffled farther apart than the 128 that are compared are not seen.

## What data cannot show

- Pings in reverse order, or a track moved as a whole, on a straight line or circle with one receiver: the image is mirrored or
  moved, and sharp.
- A lever arm or an attitude forgotten, receivers out of place by less than they tell apart, conjugate data that are compressed
  and have no pulse: only where an echo stands out over 20 pings (speckle alone fits any smooth track).
- A start of record that is late: only where the curvature of wavefronts tells the range, so on lines with a long aperture for
  their range and an echo to follow. On a level circle another depth explains the same phases.
- Clipping before filters: it has no flat tops after demodulation or compression. Look at the recorder's own samples.
- Gaps at the same ranges of all pings, which look like a range without echoes.
- The sweep's sign on speckle that is alike everywhere and longer than the record: nothing stands out with either.
- Energy beyond the declared band in raw samples that is white: receivers' noise looks so too, and compression removes it.
- Two of many receivers exchanged that stand far apart: echoes are followed in four channels.
- Order and positions where pings have sound speeds of their own, or less than a quarter of the record in common: these are not
  looked at then. The sweep, and conjugate data, where no pulse is in the file.

## Uneven phase centres

An array whose phase centres overlap or miss those of the next ping images each point again, at the angle that `check` names.
The level is that of the ghost's energy; as its place changes with frequency it is smeared, and its peak lies lower (six
receivers that advance 0.93 of their length: energy -24 dB, peak -39 dB). `weights="uniform-angle"` in `backproject` and `ffbp`
weighs every phase centre by the arc it stands for, as weights of its gap to its neighbours do: -47 dB, which is side lobes.
"""


def table(seed=0):
    """Rows of the document, how many good surveys there are, and what was said of them."""
    good = list(cases(seed))
    said = {case.name: spoken(case.formed(case.echoes)) for case in good}
    rows = []
    for mistake in MISTAKES:
        found, example, count = [], "", 0
        for case in (case for case in good if mistake.shown(case)):
            count += 1
            right, words = named(mistake, case.with_mistake(mistake))
            found.append(right)
            if right and not example:
                example = next(f"{s} {n}: {t}" for n, s, t in words if re.search(mistake.says, f"{n}: {t}"))
        rows.append((mistake.name, mistake.where, sum(found), count, example))
    return rows, said


def main():
    arguments = parser(__doc__).parse_args()
    rows, said = table()
    wrong = {name: words for name, words in said.items() if words}
    lines = [HEAD, "| mistake | can be seen | named | found, on one of the scenes |\n|---|---|---|---|\n"]
    lines += [f"| {name} | {where} | {right} of {count} | {example} |\n" for name, where, right, count, example in rows]
    lines.append(f"\nOf the same {len(said)} scenes without a mistake {len(wrong)} are told one")
    lines.append("".join(f"; {name}: {words}" for name, words in wrong.items()) + ".\n")
    write("".join(lines) + TAIL, arguments.write)


if __name__ == "__main__":
    main()

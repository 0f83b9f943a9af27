"""What became of a search for a better track."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pysas._checks import FloatArray


@dataclass(frozen=True, eq=False, repr=False)
class Report:
    """What `align_points` or `autofocus` found, and whether it was taken.

    Attributes
    ----------
    method : str
        "align_points" or "autofocus".
    metric : str
        What `cost` is: the "entropy" of each patch, or of its "sharpness" -ln(sum |I|^4/(sum |I|^2)^2).
    informative : bool
        Whether the image has bright points to go by.
    taken : bool
        Whether the track was changed; if not, the echoes returned are those that were given.
    why : str
        In words.
    cost : (2, patch)
        Of each patch before and after; lower is sharper; both alike where nothing was taken.
    patches : (patch, 3)
        Their centres with the track returned, m.
    contrast : float
        n sum |I|^4/(sum |I|^2)^2 of the image with the claimed track: 2 in developed speckle.
    shift : (ping, 3)
        By how much each ping's phase centres were moved, m.
    yaw : (ping,)
        By how much each array was turned about the vertical, rad.
    largest : float
        The longest of the shifts, m.
    gauge : (component, 2)
        Mean, m, and slope along the track, m/m, that were taken out of each component of what was found, as no method sees
        them; on a track that turns, shifts of all pings along x and y, m.
    components : tuple of str
        Of `gauge`.
    seen : float
        Share of pings that see a bright point: the others are carried by neighbours and prior alone.
    iterations : int
        Evaluations of the cost (autofocus) or solutions (align_points).
    seconds : float
        Wall time.
    steps : tuple of str
        One line for each step that was tried.
    """

    method: str
    metric: str
    informative: bool
    taken: bool
    why: str
    cost: FloatArray
    patches: FloatArray
    contrast: float
    shift: FloatArray
    yaw: FloatArray
    largest: float
    gauge: FloatArray
    components: tuple[str, ...]
    seen: float
    iterations: int
    seconds: float
    steps: tuple[str, ...] = field(default_factory=tuple)

    def __str__(self) -> str:
        lines = [f"{self.method}: {'track moved' if self.taken else 'track unchanged'}: {self.why}"]
        lines.append(
            f"  image      {len(self.patches)} bright points, contrast {self.contrast:.3g} (developed speckle: 2), "
            f"seen by {100 * self.seen:.3g} % of the pings"
        )
        if self.taken:
            before, after = self.cost
            rms = 1e3 * np.sqrt(np.mean(np.sum(self.shift**2, axis=1)))
            lines.append(f"  moved      {1e3 * self.largest:.3g} mm at most, {rms:.3g} mm rms")
            lines.append(f"  {self.metric:<10} {before.mean():.4g} before, {after.mean():.4g} after, mean of the patches")
            for name, (mean, slope) in zip(self.components, self.gauge, strict=True):
                lines.append(f"  not seen   {name}: mean {1e3 * mean:+.3g} mm, slope {1e3 * slope:+.3g} mm/m, taken out")
        lines.append(f"  effort     {self.iterations} iterations, {self.seconds:.2f} s")
        lines += [f"  step       {step}" for step in self.steps]
        return "\n".join(lines)

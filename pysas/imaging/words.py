"""What a person is told of an image, whichever engine made it."""

from __future__ import annotations

import numpy as np

WIDE = "whole records read in float64: samples beside those that pixels read are bright"


def left_out(count: int, traces: int) -> str:
    return f"{count} of {traces} traces left out: non-finite samples"


def shortened(count: int, traces: int) -> str:
    return f"{count} of {traces} traces shortened: non-finite samples at their ends"


def direct(why: str) -> str:
    return f"summed directly: {why}"


def not_promised(tol: float, error: float) -> str:
    return (
        f"tol={tol:g} is not promised, error {error:.2g} predicted: float64 cannot tell what pixels read from the bright "
        "samples beside"
    )


def lost_beside(trace: int, channels: int) -> str:
    ping, channel = divmod(trace, channels)
    return f"the image is lost beside ping {ping}, channel {channel}: leave it out by weight 0"


def too_small(kind: np.dtype[np.complexfloating], share: float) -> str:
    return f"the image is so small that {kind} holds it within {share:.2g} of itself only: scale the data"


def spoken(seconds: float) -> str:
    """A time as a person says it."""
    if seconds < 100:
        return f"{seconds:.2g} s"
    return f"{seconds / 60:.3g} min" if seconds < 6000 else f"{seconds / 3600:.3g} h"

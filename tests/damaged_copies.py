"""Mutated copies of a file, for tests of what readers do with damage."""

from __future__ import annotations

import random
from collections.abc import Iterator


def mutated(content: bytes, draw: random.Random, count: int, swaps: tuple[tuple[bytes, bytes], ...] = ()) -> Iterator[bytes]:
    """Copies with flipped bits, a truncation, a block of zeros, or one text (a type's name) in place of another."""
    for _ in range(count):
        raw = bytearray(content)
        kind = draw.choice(("bit", "bit", "bits", "cut", "zeros", "swap"))
        place = draw.randrange(len(raw))
        if kind in ("bit", "bits"):
            for _ in range(1 if kind == "bit" else 8):
                raw[draw.randrange(len(raw))] ^= 1 << draw.randrange(8)
        elif kind == "cut":
            del raw[place:]
        elif kind == "zeros":
            raw[place : place + 16] = bytes(len(raw[place : place + 16]))
        else:
            old, new = draw.choice(swaps) if swaps else (raw[place : place + 1], b"\xff")
            raw = bytearray(bytes(raw).replace(bytes(old), new, 1))
        yield bytes(raw)

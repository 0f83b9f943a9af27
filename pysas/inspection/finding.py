"""What a check found."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """One check: its name, "ok", "warn" or "FAIL", and what was found, with what to do about it."""

    name: str
    state: str
    text: str

    def __str__(self) -> str:
        return f"{self.state:<5} {self.name:<22} {self.text}"

"""What is sent to a client that draws, and what it has been sent: values, which know nothing of rooms."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

__all__ = ["PoseHistory", "Poses"]


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """How those stand whom a client draws itself."""

    bodies: list[bytes]  # packed (body.py)
    room: dict[str, Any] | None = None  # who is there, where that has changed


@dataclass(slots=True, eq=False)
class PoseHistory:
    """One client's knowledge of a room: nobody is told the same twice."""

    room: tuple[object, ...] = ()  # its people's version, and what stands for each of their avatars
    change: int = 0  # of bodies, the last one told

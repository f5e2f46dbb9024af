"""One thing that the check of a capture has to say."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Finding", "note"]


@dataclass(frozen=True)
class Finding:
    """One thing that was found in a capture: what refuses it, or what its avatar is guessed from."""

    code: str
    """For programs: nobody, several, cut_off, small, lying, turned, face, arms, blurred, bright, dark or mask."""
    text: str
    """One line for people: what was found, and what to do."""
    refusal: bool = True
    """No avatar worth having comes of it. Else a note: one does, and would be better without."""

    @property
    def kind(self) -> str:
        """``refusal`` or ``note``."""
        return "refusal" if self.refusal else "note"


def note(code: str, text: str) -> Finding:
    """A finding that refuses nothing."""
    return Finding(code, text, refusal=False)

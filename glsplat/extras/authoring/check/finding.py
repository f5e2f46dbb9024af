"""Findings of the check of a picture."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """A reason to refuse a picture, or a note on parts of its avatar that are guessed."""

    code: str
    """Key for programs: nobody, several, cut_off, small, lying, turned, face, arms, blurred, bright, dark or mask."""
    text: str
    """One line for people: the problem, and the remedy."""
    refusal: bool = True
    """The picture is refused; otherwise the finding is a note."""

    @property
    def kind(self) -> str:
        """``refusal`` or ``note``."""
        return "refusal" if self.refusal else "note"


def note(code: str, text: str) -> Finding:
    """Return a finding that does not refuse the picture."""
    return Finding(code, text, refusal=False)

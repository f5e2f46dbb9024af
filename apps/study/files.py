"""Paths of a study: its data folder, and the avatars of a participant's conditions."""

from __future__ import annotations

from pathlib import Path

from glsplat.extras.study.design import Study

__all__ = ["DEFAULT", "avatar_files", "data_of"]

DEFAULT = "default"
"""The avatar that comes with glsplat."""


def data_of(design: Path, given: Path | None) -> Path:
    """Return the data folder: ``given``, else the one beside the ``design``."""
    return design.parent / "data" if given is None else given


def avatar_files(study: Study, participant: str) -> dict[str, Path | None]:
    """Return the avatar file of each condition for a participant (sub-007); None: the embedded avatar."""
    found = {one.name: one.file(participant) for one in study.conditions}
    return {name: None if file == DEFAULT else study.path.parent / file for name, file in found.items()}

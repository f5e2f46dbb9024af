"""Where a study's files lie: its data, and the avatars of a participant's conditions."""

from __future__ import annotations

from pathlib import Path

from glsplat.extras.study.design import Study

__all__ = ["DEFAULT", "avatar_files", "data_of"]

DEFAULT = "default"
"""The avatar that comes with glsplat."""


def data_of(design: Path, given: Path | None) -> Path:
    """The data folder: the one ``given``, else beside the ``design``."""
    return design.parent / "data" if given is None else given


def avatar_files(study: Study, participant: str) -> dict[str, Path | None]:
    """The avatar of each condition for a participant (sub-007); None: the one that comes with glsplat."""
    found = {one.name: one.file(participant) for one in study.conditions}
    return {name: None if file == DEFAULT else study.path.parent / file for name, file in found.items()}

"""Files of a study: its data folder, avatars, and the factors of a table."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from glsplat.data import PEOPLE, embedded_file
from glsplat.extras.study.design import Study

from ..usage import UsageError

if TYPE_CHECKING:
    from glsplat.extras.study.analysis.codebook import Codebook

DEFAULT = "default"  # the avatar that comes with glsplat


def data_of(design: Path, given: Path | None) -> Path:
    """Return the data folder: ``given``, else the one beside the ``design``."""
    return design.parent / "data" if given is None else given


def avatar_files(study: Study, participant: str) -> dict[str, Path | None]:
    """Return the avatar file of each condition for a participant (sub-007); None: the embedded avatar."""

    def path_of(file: str) -> Path | None:
        path = study.path.parent / file
        if file == DEFAULT:
            return None
        return embedded_file(file) if file in PEOPLE and not path.exists() else path

    return {one.name: path_of(one.file(participant)) for one in study.conditions}


def factors_of(given: str | None, book: Codebook | None, table: Path) -> dict[str, Sequence[str]]:
    """Return the factors of a table with their levels: those ``given``, else those of its codebook."""
    known = dict(book.factors) if book else {}
    if given:
        return {name: known.get(name, ()) for name in column_names(given)}
    if not known:
        raise UsageError(f"--factors is needed: there is no {table.with_suffix('.json').name} that names the factors")
    return {name: levels for name, levels in known.items() if len(levels) > 1}


def column_names(text: str) -> list[str]:
    """Return comma-separated names of columns. Raises UsageError for none or duplicates."""
    names = [name.strip() for name in text.split(",") if name.strip()]
    if not names or len(set(names)) < len(names):
        raise UsageError(f"expected names of columns with commas between them, each once, not {text!r}")
    return names

"""Where a study's files lie: its data, and the avatars of a participant's conditions."""

from __future__ import annotations

import argparse
from pathlib import Path

from glsplat.study.design import Study

__all__ = ["DEFAULT", "avatar_files", "data_of"]

DEFAULT = "default"
"""The avatar that comes with glsplat."""


def data_of(args: argparse.Namespace) -> Path:
    """The data folder: --data, else beside the design."""
    return args.data if args.data is not None else Path(args.study).parent / "data"


def avatar_files(study: Study, participant: str) -> dict[str, Path | None]:
    """The avatar of each condition for a participant (sub-007); None: the one that comes with glsplat."""
    found = {one.name: one.file(participant) for one in study.conditions}
    return {name: None if file == DEFAULT else study.path.parent / file for name, file in found.items()}

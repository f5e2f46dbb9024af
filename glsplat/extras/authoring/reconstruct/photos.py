"""From files of photographs to an avatar: read, checked, reconstructed, and marked with where it comes from."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any, TypeVar

from glsplat.avatar import Avatar
from glsplat.errors import CaptureError, FormatError, GlsplatError
from glsplat.extras.authoring.check.capture import VIEWS, Capture, check_capture, is_outline
from glsplat.extras.authoring.compute.threads import one_blas_thread
from glsplat.extras.authoring.networks.people import find_person
from glsplat.extras.authoring.photo.photo_file import Photo, read_photo
from glsplat.extras.authoring.segment.mask import person_mask
from glsplat.extras.authoring.segment.mask_file import MaskSource, mask_of
from glsplat.meshes import RiggedMesh
from glsplat.skinning.smplx import JOINT_NAMES

from .plugins import one_line
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
    "CheckedPhoto",
    "MeshReconstruction",
    "PhotoSource",
    "Reconstruction",
    "check_photos",
    "from_photos",
    "mesh_from_photos",
    "reconstruct",
    "reconstruct_mesh",
    "refuse",
    "today",
]

T = TypeVar("T")

PhotoSource = str | os.PathLike[str] | Photo
"""A picture file, or what ``read_photo`` or ``photo_of`` made of one."""
_DEFAULT = Options()


@dataclass(frozen=True, eq=False)
class CheckedPhoto:
    """One photograph, read and checked."""

    side: str
    """Which side of the person it shows: front, back, left or right."""
    name: str
    """For messages: the file, or the side."""
    photo: Photo
    capture: Capture


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """An avatar, and what it was made from."""

    avatar: Avatar
    shots: Mapping[str, CheckedPhoto]
    made_by: str
    """The reconstructor's name."""
    made: MadeAvatar | None = None
    """What the built-in reconstructor can tell beside the avatar; None of others."""


@dataclass(frozen=True, eq=False)
class MeshReconstruction:
    """A textured mesh, and what it was made from."""

    mesh: RiggedMesh
    shots: Mapping[str, CheckedPhoto]
    made_by: str
    """The reconstructor's name."""
    made: FittedBody


@one_blas_thread()
def check_photos(
    front: PhotoSource,
    *,
    back: PhotoSource | None = None,
    left: PhotoSource | None = None,
    right: PhotoSource | None = None,
    masks: Mapping[str, MaskSource] | None = None,
    progress: Progress | None = None,
) -> dict[str, CheckedPhoto]:
    """Read all pictures, then check each; findings are in ``CheckedPhoto.capture``, nobody is refused yet (``refuse``).

    ``masks`` by side; a picture that is transparent about the person is its own. Findings are refusals or notes. Where
    nobody is found, whoever is most like a person is kept beside that finding. Raises FormatError for files that
    cannot be read or used.
    """
    show = progress or _silent
    given = {"front": front, "back": back, "left": left, "right": right}
    sources = {side: source for side, source in given.items() if source is not None}
    for side in masks or {}:
        if side not in sources:
            known = "front, back, left or right" if side not in VIEWS else f"give the {side} picture, too"
            raise FormatError(f'there is a mask for "{side}" and no picture; {known}')
    photos, outlines = {}, {}
    for index, (side, source) in enumerate(sources.items()):
        show("reading the pictures", index / len(sources))
        photo = photos[side] = source if isinstance(source, Photo) else read_photo(source)
        if masks is not None and side in masks:
            outlines[side] = mask_of(masks[side], photo)
    shots = {}
    for index, (side, photo) in enumerate(photos.items()):
        show(f"checking the {side}", index / len(photos))
        if side not in outlines and photo.alpha is not None:
            photo = _with_own_mask(photo, side, outlines)
        capture = check_capture(photo.picture, side, given=outlines.get(side))
        if capture.person is None and (person := find_person(photo.picture)) is not None:
            mask = outlines[side] if side in outlines else person_mask(photo.picture, person.body)
            capture = Capture(capture.findings, person, mask)
        named_by = f"{side} picture" if isinstance(sources[side], Photo) else str(sources[side])
        shots[side] = CheckedPhoto(side, named_by, photo, capture)
    show("checking the pictures", 1.0)
    return shots


def _with_own_mask(photo: Photo, side: str, outlines: dict[str, Mask]) -> Photo:
    """The transparency as the person's outline, where it is one: corners and frames are transparent, too."""
    assert photo.alpha is not None
    solid = photo.alpha > 127
    person = find_person(photo.picture)
    if person is None or not solid.any() or is_outline(person, solid):
        outlines[side] = solid
        return photo
    said = "its transparent parts are not the room around the person, the outline is found without them"
    return replace(photo, notes=(*photo.notes, said))


def refuse(shots: Mapping[str, CheckedPhoto], made: FittedBody | None = None) -> None:
    """Raise CaptureError, one line for what refuses a picture and for a body that does not fit; else silent."""
    found = [
        (shot, finding.code, finding.text)
        for shot in shots.values()
        for finding in shot.capture.findings
        if finding.refusal
    ]
    if made is not None and made.problem:
        text = f"the body does not fit the picture ({made.problem}); take another one"
        found.append((shots["front"], "fit", text))
    if found:
        lines = "; also ".join(f"{shot.name}: {text}" for shot, _, text in found)
        raise CaptureError(lines, tuple((shot.side, code, text) for shot, code, text in found))


def reconstruct(
    shots: Mapping[str, CheckedPhoto],
    options: Options | None = None,
    *,
    using: str | Reconstructor = "builtin",
    anyway: bool = False,
    meta: Mapping[str, Any] | None = None,
) -> Reconstruction:
    """An avatar from photographs that ``check_photos`` read.

    ``using`` is a reconstructor or its name. ``anyway`` goes on with pictures in which the check found faults, and
    keeps a body that does not fit them. ``meta`` goes into the avatar's notes, over what is written there: source,
    made_by, date (SOURCE_DATE_EPOCH's day, else today's, UTC), consent, body_model, unseen; never a picture or a
    path. Raises CaptureError, and GlsplatError from reconstructors.
    """

    def work(maker: Reconstructor, *asked: Any) -> tuple[Avatar, MadeAvatar | None]:
        if isinstance(maker, ReportingReconstructor):
            made = maker.tell(*asked)
            return made.avatar, made
        return maker.reconstruct(*asked), None

    name, day, (avatar, made) = _done(shots, options, using, anyway, work)
    if not isinstance(avatar, Avatar) or avatar.skeleton.names != JOINT_NAMES:
        raise GlsplatError(f'the reconstructor "{name}" gave {avatar!r:.100}, not an avatar on the joints of SMPL-X')
    if not anyway:
        refuse(shots, made)
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
    """As ``reconstruct``, a textured mesh in place of splats: the fitted body with the photographs in its textures.

    Raises GlsplatError, too, where the reconstructor makes no meshes.
    """

    def work(maker: Reconstructor, *asked: Any) -> FittedBody:
        if not isinstance(maker, MeshReconstructor):
            raise GlsplatError(f'the reconstructor "{_name_of(using)}" makes splats, no meshes; use "builtin"')
        return maker.mesh(*asked)

    name, day, made = _done(shots, options, using, anyway, work)
    if not isinstance(made, FittedBody) or made.mesh.skeleton.names != JOINT_NAMES:
        raise GlsplatError(f'the reconstructor "{name}" gave {made!r:.100}, not a mesh on the joints of SMPL-X')
    if not anyway:
        refuse(shots, made)
    notes = _notes(made.mesh.meta, shots, name, day, made) | dict(meta or {})
    return MeshReconstruction(replace(made.mesh, meta=notes), dict(shots), name, made)


def _name_of(using: str | Reconstructor) -> str:
    return using if isinstance(using, str) else type(using).__name__


@one_blas_thread()
def _done(
    shots: Mapping[str, CheckedPhoto],
    options: Options | None,
    using: str | Reconstructor,
    anyway: bool,
    work: Callable[[Reconstructor, Mapping[str, Picture], Mapping[str, Mask], Options], T],
) -> tuple[str, str, T]:
    """The reconstructor's name, the day, and what came of its ``work``."""
    if not anyway or any(shot.capture.person is None for shot in shots.values()):
        refuse(shots)
    day = today()
    name = _name_of(using)
    maker = named(using) if isinstance(using, str) else using
    pictures = {
        side: Picture(shot.photo.picture, shot.photo.focal, shot.capture.person) for side, shot in shots.items()
    }
    masks = {side: shot.capture.mask for side, shot in shots.items()}
    try:
        return name, day, work(maker, pictures, masks, options or Options())
    except GlsplatError:
        raise
    except Exception as error:
        if name in OWN:
            raise
        raise GlsplatError(f'the reconstructor "{name}" failed: {one_line(error)}') from error


def _notes(
    given: Mapping[str, Any], shots: Mapping[str, CheckedPhoto], name: str, day: str, made: FittedBody | None
) -> dict[str, Any]:
    """``given`` with where it comes from."""
    notes = dict(given)
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
    """An avatar from one photograph of a person, or several; ``height`` in metres.

    The pictures are checked before any other work: CaptureError says what is wrong with them. ``check_photos`` and
    ``reconstruct`` are the two halves, for who wants to know more than the avatar.

    >>> from glsplat.extras.authoring.reconstruct.photos import from_photos
    >>> from_photos("me.jpg", height=1.74)
    Traceback (most recent call last):
    glsplat.errors.FormatError: me.jpg: cannot be read (No such file or directory)
    """
    options = Options(height=height, splats=splats, seed=seed, steps=steps, progress=progress or _silent)
    shots = check_photos(front, back=back, left=left, right=right, masks=masks, progress=progress)
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
    """As ``from_photos``, a mesh with a texture of ``texture`` texels a side in place of splats."""
    options = Options(height=height, texture=texture, progress=progress or _silent)
    shots = check_photos(front, back=back, left=left, right=right, masks=masks, progress=progress)
    return reconstruct_mesh(shots, options, using=using, anyway=anyway, meta=meta).mesh


def _silent(step: str, done: float) -> None: ...


def today() -> str:
    """YYYY-MM-DD in UTC; of SOURCE_DATE_EPOCH, where it is set, so that files can be made again byte for byte."""
    told = os.environ.get("SOURCE_DATE_EPOCH")
    if told is None:
        return datetime.now(UTC).date().isoformat()
    try:
        return datetime.fromtimestamp(int(told), UTC).date().isoformat()
    except (ValueError, OverflowError, OSError):
        raise GlsplatError(f"SOURCE_DATE_EPOCH needs whole seconds since 1970, not {told[:40]!r}") from None

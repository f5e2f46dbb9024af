"""Read and check all photographs of a person."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import CaptureError, FormatError
from glsplat.extras.authoring.check.capture import Capture, check_capture, is_outline
from glsplat.extras.authoring.compute.threads import one_blas_thread
from glsplat.extras.authoring.networks.people import SIDES, find_person
from glsplat.extras.authoring.photo.photo_file import Photo, read_photo
from glsplat.extras.authoring.segment.mask import MaskSource, person_mask, read_mask

Mask = NDArray[np.bool_]
PhotoSource = str | os.PathLike[str] | Photo
"""A picture file or a decoded one."""


@dataclass(frozen=True, eq=False)
class CheckedPhoto:
    """One photograph, read and checked."""

    side: str
    """Side of the person that it shows: front, back, left or right."""
    name: str
    """Name in messages: the file or the side."""
    photo: Photo
    capture: Capture


@one_blas_thread()
def check_photos(
    front: PhotoSource,
    *,
    back: PhotoSource | None = None,
    left: PhotoSource | None = None,
    right: PhotoSource | None = None,
    masks: Mapping[str, MaskSource] | None = None,
    progress: Callable[[str, float], None] = lambda step, done: None,
) -> dict[str, CheckedPhoto]:
    """Read all pictures, then check each, and return them by side; see ``refuse`` for the findings.

    ``masks`` are by side; a picture that is transparent around the person is its own mask. With the finding that
    nobody is shown, the most likely person is kept. Raises FormatError for files that cannot be read or used.
    """
    by_side = {"front": front, "back": back, "left": left, "right": right}
    sources = {side: source for side, source in by_side.items() if source is not None}
    for side in masks or {}:
        if side not in sources:
            known = "front, back, left or right" if side not in SIDES else f"give the {side} picture, too"
            raise FormatError(f'there is a mask for "{side}" and no picture; {known}')
    photos, outlines = {}, {}
    for index, (side, source) in enumerate(sources.items()):
        progress("reading the pictures", index / len(sources))
        photo = photos[side] = source if isinstance(source, Photo) else read_photo(source)
        if masks is not None and side in masks:
            outlines[side] = read_mask(masks[side], photo)
    shots = {}
    for index, (side, photo) in enumerate(photos.items()):
        progress(f"checking the {side}", index / len(photos))
        if side not in outlines and photo.alpha is not None:
            photo = _with_own_mask(photo, side, outlines)
        capture = check_capture(photo.picture, side, known_mask=outlines.get(side))
        if capture.person is None and (person := find_person(photo.picture)) is not None:
            mask = outlines[side] if side in outlines else person_mask(photo.picture, person.body)
            capture = Capture(capture.findings, person, mask)
        name = f"{side} picture" if isinstance(sources[side], Photo) else str(sources[side])
        shots[side] = CheckedPhoto(side, name, photo, capture)
    progress("checking the pictures", 1.0)
    return shots


def _with_own_mask(photo: Photo, side: str, outlines: dict[str, Mask]) -> Photo:
    """Use the picture's opacity as mask if it is the person; corners and frames may be transparent, too."""
    assert photo.alpha is not None
    solid = photo.alpha > 127
    person = find_person(photo.picture)
    if person is None or not solid.any() or is_outline(person, solid):
        outlines[side] = solid
        return photo
    note = "its transparent parts are not the room around the person, the outline is found without them"
    return replace(photo, notes=(*photo.notes, note))


def refuse(shots: Mapping[str, CheckedPhoto], problem: str = "") -> None:
    """Raise CaptureError, one line, for findings that refuse a picture and for the ``problem`` of a fit, if any."""
    found = [
        (shot, finding.code, finding.text)
        for shot in shots.values()
        for finding in shot.capture.findings
        if finding.refusal
    ]
    if problem:
        text = f"the body does not fit the picture ({problem}); take another one"
        found.append((shots["front"], "fit", text))
    if found:
        lines = "; also ".join(f"{shot.name}: {text}" for shot, _, text in found)
        raise CaptureError(lines, tuple((shot.side, code, text) for shot, code, text in found))

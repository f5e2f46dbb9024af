"""From a video of somebody who turns, or pictures from all around, to a textured mesh or an avatar of splats."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from typing import Any

import numpy as np

from glsplat.avatar import Avatar
from glsplat.errors import CaptureError, FormatError
from glsplat.extras.authoring.body.open_body import open_body
from glsplat.extras.authoring.dress.fitted_mesh import dressed_mesh
from glsplat.extras.authoring.fit.body_fit import BodyFit, FittedView
from glsplat.extras.authoring.fit.details import fit_details
from glsplat.extras.authoring.fit.eyes import read_eyes
from glsplat.extras.authoring.fit.view import View
from glsplat.extras.authoring.geometry.surface_points import triangle_areas
from glsplat.extras.authoring.optimize.photo_fit import fitted_to_photos
from glsplat.extras.authoring.paint.bake import bake
from glsplat.extras.authoring.paint.view_fusion import Fusion, fusion_of
from glsplat.extras.authoring.paint.view_sample import FittedPicture
from glsplat.extras.authoring.sample.scatter import scatter
from glsplat.extras.authoring.video.body import fit_turning, key_views
from glsplat.extras.authoring.video.film import FEWEST
from glsplat.extras.authoring.video.frames import Frame, FramePicture, FrameSource, check_frames, frames_of
from glsplat.meshes import RiggedMesh

from .builtin import PHONE
from .photos import today
from .reconstructor import Options

__all__ = ["FORMS", "FRAMES", "VideoResult", "checked_form", "from_pictures", "from_video", "reconstruct_frames"]

FORMS = ("mesh", "splats")
FRAMES = 30
"""Frames of a video that are used."""
_MOST_FRAMES = 120
_HARDLY = 0.1  # of a point that a frame shows too flatly to be believed
_MET, _GOOD = 0.85, 0.93  # overlap with the mask below which a frame is not used, and least median of all
_BLURRED, _MISSED = 0.3, 1.0  # of the cosine between surface and sight
_LEAST_USED = 0.7  # share of the frames


@dataclass(frozen=True, eq=False)
class VideoResult:
    """What a video gave."""

    thing: RiggedMesh | Avatar
    fit: BodyFit
    mesh: RiggedMesh  # the dressed body in the zero pose, without texture
    frames: tuple[Frame, ...]  # that were used, the most frontal first; the fit's views in the same order
    unseen: float  # share of the surface that no frame shows
    problem: str  # one line, or empty
    left_out: tuple[str, ...] = ()  # a line for each frame that would not do


def checked_form(form: str) -> str:
    """FormatError for a form that is none of FORMS."""
    if form not in FORMS:
        raise FormatError(f'an avatar of a video is made as {" or ".join(FORMS)}, not "{form}"')
    return form


def reconstruct_frames(
    frames: Sequence[Frame], options: Options | None = None, *, form: str = "mesh", anyway: bool = False
) -> VideoResult:
    """A textured mesh or splats of frames that ``check_frames`` chose.

    Raises CaptureError for a body that does not fit them; with ``anyway`` that is in ``problem``.
    """
    checked_form(form)
    options = options or Options()
    body = open_body()
    views = [
        View(frame.mask, frame.person.body.points, frame.person.body.visible, _focal(frame), turn=frame.turn)
        for frame in frames
    ]
    fit = fit_turning(views, options.height, body, lambda done: options.progress("fitting the body", 0.4 + 0.3 * done))
    options.progress("fitting face and hands", 0.7)
    fit = fit_details(fit, views, [frame.person for frame in frames], body)
    used = [index for index, view in enumerate(fit.views) if index == 0 or view.overlap >= _MET]
    problem = _problem(fit, len(used))
    if problem and not anyway:
        raise CaptureError(problem)
    fit = replace(fit, views=tuple(fit.views[index] for index in used), problem=problem)
    frames = tuple(frames[index] for index in used)
    options.progress("painting", 0.75)
    mesh = dressed_mesh(body, fit)
    shots = [
        FittedPicture(frame.picture, frame.mask, _focal(frame), view, mesh)
        for frame, view in zip(frames, fit.views, strict=True)
    ]
    looks = read_eyes(frames[0].picture, frames[0].person.face)
    fusion = fusion_of(body, shots, looks, [_doubt(frame, view) for frame, view in zip(frames, fit.views, strict=True)])
    thing: RiggedMesh | Avatar
    if form == "mesh":
        options.progress("baking the texture", 0.85)
        thing = bake(mesh, fusion.colours, options.texture)
    else:
        thing = _splats(mesh, fusion, frames, shots, options)
    options.progress("painting", 1.0)
    return VideoResult(thing, fit, mesh, frames, _unseen(mesh, fusion), problem)


def _splats(
    mesh: RiggedMesh, fusion: Fusion, frames: Sequence[Frame], shots: Sequence[FittedPicture], options: Options
) -> Avatar:
    rng = np.random.default_rng(options.seed)
    strewn = scatter(mesh, options.splats, rng)
    painted = fusion.paint(strewn.points)
    options.progress("placing splats", 0.85)
    avatar = strewn.avatar(mesh, painted.rgb, painted.detail, rng)
    some = key_views([frame.turn for frame in frames])  # all together ask for nearly the same, in gigabytes
    shots = [shots[index] for index in some]
    return fitted_to_photos(
        avatar, mesh, fusion.colours, shots, options.seed, options.steps, options.texture, options.progress
    )


def from_video(
    *sources: FrameSource,
    options: Options | None = None,
    form: str = "mesh",
    frames: int = FRAMES,
    anyway: bool = False,
    meta: Mapping[str, Any] | None = None,
) -> VideoResult:
    """A textured mesh, or splats, of one video of somebody who turns on the spot, or of pictures from all around.

    ``frames`` of a video are used; ``anyway`` goes on where the check found faults; ``meta`` goes into the notes, over
    what is written there: source, made_by, date, consent, body_model, unseen. Raises CaptureError for what will not do.

    >>> from glsplat.extras.authoring.reconstruct.video import from_video
    >>> from_video("turn.mp4")
    Traceback (most recent call last):
    glsplat.errors.FormatError: turn.mp4: cannot be read (No such file or directory)
    """
    options = options or Options()
    checked_form(form)
    if not FEWEST <= frames <= _MOST_FRAMES:
        raise FormatError(f"a turn needs {FEWEST} to {_MOST_FRAMES} frames, not {frames}")
    options.progress("reading the frames", 0.0)
    pictures, in_order = frames_of(sources, frames)
    return from_pictures(pictures, in_order=in_order, options=options, form=form, anyway=anyway, meta=meta)


def from_pictures(
    pictures: Sequence[FramePicture],
    *,
    in_order: bool,
    options: Options | None = None,
    form: str = "mesh",
    anyway: bool = False,
    meta: Mapping[str, Any] | None = None,
) -> VideoResult:
    """``from_video`` of pictures that are read; ``in_order`` where they follow each other in time."""
    options = options or Options()
    show = options.progress
    frames, left_out = check_frames(
        pictures,
        in_order=in_order,
        anyway=anyway,
        progress=lambda done: show("looking at the frames", 0.05 + 0.35 * done),
    )
    made = reconstruct_frames(frames, options, form=form, anyway=anyway)
    notes = {
        "source": f"{len(made.frames)} pictures of a turn",
        "made_by": f"glsplat {version('glsplat')}, video",
        "date": today(),
        "consent": "not stated",
        "body_model": "SMPL-X joints (55)",
        "unseen": round(float(made.unseen), 4),
    }
    thing = replace(made.thing, meta=dict(made.thing.meta) | notes | dict(meta or {}))
    return replace(made, thing=thing, left_out=tuple(left_out))


def _focal(frame: Frame) -> float:
    return frame.focal or PHONE * max(frame.picture.shape[:2])


def _doubt(frame: Frame, view: FittedView) -> float:
    """How much less a frame is worth that is blurred, or that the body does not fit."""
    return _BLURRED * frame.blur + _MISSED * (1 - view.overlap)


def _problem(fit: BodyFit, used: int) -> str:
    """One line that says why not to trust a fit, or nothing. Landmarks of sides are too rough to be asked."""
    met = float(np.median([view.overlap for view in fit.views]))
    if met < _GOOD:
        return f"the body covers {met:.1%} of the person in most frames, not {_GOOD:.0%}; stand in an A-pose, and alone"
    if used < _LEAST_USED * len(fit.views) or used < FEWEST:
        return f"the body fits {used} of {len(fit.views)} frames; keep the pose while turning, and the camera still"
    return ""


def _unseen(mesh: RiggedMesh, fusion: Fusion) -> float:
    """Share of the skin's area that no frame shows."""
    faces = mesh.parts[0].faces
    hidden = fusion.visibility[faces].mean(axis=1) < _HARDLY
    return float(np.average(hidden, weights=triangle_areas(mesh.vertices, faces)))

"""Make a textured mesh or an avatar of splats from a video of a turning person, or pictures from all around."""

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
from glsplat.extras.authoring.video.film import MIN_FRAMES
from glsplat.extras.authoring.video.frames import Frame, FramePicture, FrameSource, check_frames, frames_of
from glsplat.meshes import RiggedMesh

from .builtin import MIN_TRUST, PHONE_FOCAL_FACTOR
from .photos import today
from .reconstructor import Options

FORMS = ("mesh", "splats")
FRAMES = 30
"""Frames of a video that are used by default."""
MAX_FRAMES = 120
_MIN_OVERLAP, _MIN_MEDIAN_OVERLAP = 0.85, 0.93  # overlap with the mask: of a used frame, and of all
_BLUR_PENALTY = 0.3  # off the cosine of the viewing angle, for a completely blurred frame
_MIN_USED_FRACTION = 0.7  # of the frames


@dataclass(frozen=True, eq=False)
class VideoResult:
    """The result of a video."""

    content: RiggedMesh | Avatar
    fit: BodyFit
    mesh: RiggedMesh  # the dressed body in the zero pose, without texture
    frames: tuple[Frame, ...]  # used frames, the most frontal first, in the order of the fit's views
    unseen: float  # fraction of the surface that no frame shows
    problem: str  # one line, or empty
    left_out: tuple[str, ...] = ()  # a line for each unusable frame


def _check_form(form: str) -> None:
    if form not in FORMS:
        raise FormatError(f'an avatar of a video is made as {" or ".join(FORMS)}, not "{form}"')


def reconstruct_frames(
    frames: Sequence[Frame], options: Options | None = None, *, form: str = "mesh", anyway: bool = False
) -> VideoResult:
    """Make a textured mesh or splats of frames that ``check_frames`` chose.

    Raises CaptureError for a body that does not fit them; with ``anyway`` it goes to ``problem``.
    """
    _check_form(form)
    options = options or Options()
    body = open_body()
    views = [
        View(frame.mask, frame.person.body.points, frame.person.body.visible, _focal(frame), turn=frame.turn)
        for frame in frames
    ]
    fit = fit_turning(views, options.height, lambda done: options.progress("fitting the body", 0.4 + 0.3 * done))
    options.progress("fitting face and hands", 0.7)
    fit = fit_details(fit, views, [frame.person for frame in frames])
    used = [index for index, view in enumerate(fit.views) if index == 0 or view.overlap >= _MIN_OVERLAP]
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
    penalties = [_penalty(frame, view) for frame, view in zip(frames, fit.views, strict=True)]
    fusion = fusion_of(body, shots, looks, penalties)
    content: RiggedMesh | Avatar
    if form == "mesh":
        options.progress("baking the texture", 0.85)
        content = bake(mesh, fusion.colours, options.texture)
    else:
        content = _splats(mesh, fusion, frames, shots, options)
    options.progress("painting", 1.0)
    return VideoResult(content, fit, mesh, frames, _unseen_fraction(mesh, fusion), problem)


def _splats(
    mesh: RiggedMesh, fusion: Fusion, frames: Sequence[Frame], shots: Sequence[FittedPicture], options: Options
) -> Avatar:
    rng = np.random.default_rng(options.seed)
    scattered = scatter(mesh, options.splats, rng)
    painted = fusion.paint(scattered.points)
    options.progress("placing splats", 0.85)
    avatar = scattered.avatar(mesh, painted.rgb, painted.detail, rng)
    keys = key_views([frame.turn for frame in frames])  # all frames would add little, and take gigabytes
    shots = [shots[index] for index in keys]
    return fitted_to_photos(avatar, mesh, fusion.colours, shots, options.seed, options.steps, options.progress)


def from_video(
    *sources: FrameSource,
    options: Options | None = None,
    form: str = "mesh",
    frames: int = FRAMES,
    anyway: bool = False,
    meta: Mapping[str, Any] | None = None,
) -> VideoResult:
    """Make a textured mesh or splats of one video of a person who turns on the spot, or of pictures from all around.

    ``frames`` of a video are used; ``anyway`` accepts frames in which the check found faults; ``meta`` overrides the
    metadata: source, made_by, date, consent, body_model, unseen. Raises CaptureError for unusable frames.

    >>> from glsplat.extras.authoring.reconstruct.video import from_video
    >>> from_video("turn.mp4")
    Traceback (most recent call last):
    glsplat.errors.FormatError: turn.mp4: cannot be read (No such file or directory)
    """
    options = options or Options()
    _check_form(form)
    if not MIN_FRAMES <= frames <= MAX_FRAMES:
        raise FormatError(f"a turn needs {MIN_FRAMES} to {MAX_FRAMES} frames, not {frames}")
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
    """Make a mesh or splats of pictures as ``from_video`` does; ``in_order``: they follow each other in time."""
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
    content = replace(made.content, meta=dict(made.content.meta) | notes | dict(meta or {}))
    return replace(made, content=content, left_out=tuple(left_out))


def _focal(frame: Frame) -> float:
    return frame.focal or PHONE_FOCAL_FACTOR * max(frame.picture.shape[:2])


def _penalty(frame: Frame, view: FittedView) -> float:
    """Return the penalty on the colours of a frame, for blur and missing overlap."""
    return _BLUR_PENALTY * frame.blur + (1 - view.overlap)


def _problem(fit: BodyFit, used: int) -> str:
    """Return one line about an unreliable fit, or "". Landmarks of side views are too rough to judge by."""
    median = float(np.median([view.overlap for view in fit.views]))
    if median < _MIN_MEDIAN_OVERLAP:
        covered = f"the body covers {median:.1%} of the person in most frames, not {_MIN_MEDIAN_OVERLAP:.0%}"
        return f"{covered}; stand in an A-pose, and alone"
    if used < _MIN_USED_FRACTION * len(fit.views) or used < MIN_FRAMES:
        return f"the body fits {used} of {len(fit.views)} frames; keep the pose while turning, and the camera still"
    return ""


def _unseen_fraction(mesh: RiggedMesh, fusion: Fusion) -> float:
    """Return the fraction of the skin's area that no frame shows."""
    faces = mesh.parts[0].faces
    hidden = fusion.visibility[faces].mean(axis=1) < MIN_TRUST
    return float(np.average(hidden, weights=triangle_areas(mesh.vertices, faces)))

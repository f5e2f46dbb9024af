"""Pictures of a person to the open body in their shape, pose and clothes, and how well that went."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError
from glsplat.extras.authoring.body.open_body import Body, open_body
from glsplat.extras.authoring.body.segments import arm_layers
from glsplat.extras.authoring.compute.threads import map_threads
from glsplat.extras.authoring.fit.kinematics import PosedBody, projected
from glsplat.extras.authoring.fit.landmarks import landmarks
from glsplat.extras.authoring.fit.offsets import face_of, outward, smooth_offsets, soles_of
from glsplat.extras.authoring.fit.outline import (
    Rim,
    brimless,
    edge_distances,
    find_rim,
    half_gaps,
    lengths_inside,
    overlap,
    projected_mask,
)
from glsplat.extras.authoring.fit.prior import HINGES, POSED, PosePrior
from glsplat.extras.authoring.fit.solver import BodySolver
from glsplat.extras.authoring.fit.standing.doubt import doubts_of, unseen
from glsplat.extras.authoring.fit.standing.limbs import before_trunk, beside_arms, hands, hidden_arms
from glsplat.extras.authoring.fit.standing.stances import ASIDE, metres_of, misread, stances_of
from glsplat.extras.authoring.fit.view import View
from glsplat.extras.authoring.networks.people import degrees_between
from glsplat.meshes import vertex_normals
from glsplat.skinning.smplx import JOINT_NAMES

__all__ = [
    "FIGURE",
    "BodyFit",
    "FittedView",
    "assembled",
    "converge",
    "dressed",
    "fit_body",
    "follow_outlines",
    "strays_of",
]

F64 = NDArray[np.float64]

FIGURE = 480.0
"""Pixels of the person's height that the fit works with."""

_ROUNDS = 4  # outlines looked for again, each time the unknowns improved
_DRESSINGS = 5  # outlines looked for again, each time the surface moved
_RIM_ROWS = 500
_RIM_WORTH = 36.0  # as many independent measurements an outline is
_CLOTH, _INSIDE = 0.008, 0.03  # shares of the figure: beyond it the mask says little, far in it is a mistake
_REACH = 0.04  # shares of the figure; how far from the body the mask's edge is looked for
_FLAT, _FLAT_DRESSED = 0.35, 0.22  # cosines below which a vertex is on the outline; cloth has the sharper one
_PLAIN = 0.8  # cosine between normal and offset; a vertex below it, in an ear's folds, is moved by its neighbours alone
_SOLE = 0.020  # metres; a thicker one would be height that the body lacks
_FEW = 4  # views whose outlines hardly cross each other
_HEIGHTS = 0.5, 2.5  # metres
_ARM_REACH, _ARM_REACH_DRESSED = 0.015, 0.03  # shares of the figure: so near an arm no outline is a trunk's
_ARM_EDGE = 0.008  # the same: what is farther from an arm, and of the person, is trunk
_HELD_REACH, _HELD = 0.08, 0.025  # shares of the figure; so near a hand, what stands so far off is no cloth
_ARM_MARKS, _WRIST_MARKS = (13, 14, 15, 16), (15, 16)  # landmarks of elbows and wrists
# Against a fit speak: a percent uncovered, a percent that landmarks and those of arms stray, an arm hidden that is seen
# or seen that is hidden, arms that point elsewhere than the network's metres by their length; and that it is an unusual
# stance. Weights chosen on eight made-up people in nine poses.
_AGAINST, _UNUSUAL = (1.0, 2.0, 0.5, 6.0, 12.0), 2.0
_FRONT = 45.0  # degrees; somebody who has turned so far still shows both forearms before the trunk
_GOOD = 0.88, 2.0  # least overlap with the mask, most mean distance of landmarks in shares of the figure (%)

_TRUST = {"wrist": 1.0, "elbow": 1.0, "head": 0.35, "neck": 0.35, "jaw": 0.35, "foot": 0.5, "ankle": 0.5}
_CLOTHED = 0.6
_HEAD = JOINT_NAMES.index("head")
_FINGERS = ("index", "middle", "pinky", "ring", "thumb")


@dataclass(frozen=True, eq=False)
class FittedView:
    """The body as one picture shows it; OpenCV camera axes, metres."""

    rotations: F64  # [55, 3] axis-angle, radians; the root's row is zero, its turn is in ``root``
    root: F64  # [3, 3] the body's axes in the camera's
    pelvis: F64  # [3] where the pelvis is
    joints: F64  # [55, 3] where the joints are
    vertices: F64  # [V, 3] where the dressed surface is
    pixels: F64  # [V, 2] where the picture has it
    overlap: float  # intersection over union of the dressed surface and the mask
    strays: float  # mean distance of the landmarks from where the body has them, in percent of the figure's height
    doubts: Mapping[str, float] = field(default_factory=dict)  # by limb, 0 to 1; see ``doubts_of``


@dataclass(frozen=True, eq=False)
class BodyFit:
    """What the pictures say of a person. ``problem`` is empty, or one line that says why not to trust it."""

    betas: F64  # [10] shape
    stature: float  # metres, crown to sole without hair and shoes
    offsets: F64  # [V] metres along ``outward`` of the zero pose: clothes and hair
    rest: F64  # [V, 3] the dressed surface in the zero pose
    joints: F64  # [55, 3] in the zero pose
    views: tuple[FittedView, ...]
    problem: str


def fit_body(views: Sequence[View], height: float | None = None, body: Body | None = None) -> BodyFit:
    """Fit the open body to one picture or several of one person; ``height`` in metres where it is known.

    Landmarks first, then the outlines of the bare body, into which clothes pull little and which they push hard; then
    the surface moves along its normals until its outline meets the masks. Several pictures share the shape and, but
    for a few degrees a joint, the pose. Raises FormatError; a fit that did not converge says so in ``problem``.

    >>> from glsplat.extras.authoring.fit.body_fit import fit_body
    >>> fit_body([])
    Traceback (most recent call last):
    glsplat.errors.FormatError: a fit needs at least one picture
    """
    if not views:
        raise FormatError("a fit needs at least one picture")
    if height is not None and not _HEIGHTS[0] <= height <= _HEIGHTS[1]:
        raise FormatError(f"a height needs metres from {_HEIGHTS[0]} to {_HEIGHTS[1]}, not {height:g}")
    body = body or open_body()
    fits = map_threads(lambda stance: _begun_with(stance, views, height, body), stances_of(views[0], body))
    fit = min(fits, key=lambda fitted: fitted[1])[0]
    missing = [line for seen, view in zip(fit.views, views, strict=True) if (line := unseen(seen.doubts, view.side))]
    return replace(fit, problem="; ".join([fit.problem] * bool(fit.problem) + missing))


def _begun_with(stance: PosePrior, views: Sequence[View], height: float | None, body: Body) -> tuple[BodyFit, float]:
    """The fit of somebody who may stand so, and how much speaks against it."""
    solver = BodySolver(body, landmarks(), [view.smaller(FIGURE) for view in views], height, stance=stance)
    converge(solver)
    poses = [solver.posed(index) for index in range(len(views))]
    rotations = [HINGES.rotations(solver.angles(index)) for index in range(len(views))]
    bare, joints = body.shaped(solver.betas)
    offsets = dressed(body, bare, poses, views)
    fit = assembled(body, bare, joints, offsets, poses, rotations, views, strays_of(solver))
    usual = stance is POSED or abs(stance.turn) > ASIDE  # nobody poses who has turned aside
    against, told = 0.0 if usual else _UNUSUAL, []
    for index, (seen, view) in enumerate(zip(fit.views, views, strict=True)):
        arms = np.linalg.norm(solver.strayed(index, pixels=True)[np.isin(solver.table.numbers, _ARM_MARKS)], axis=1)
        hidden = hidden_arms(body, seen.vertices, seen.pixels, view.focal, view.mask.shape)
        percents = (1 - seen.overlap) * 100, seen.strays, arms.mean() / solver.views[index].figure * 100
        shown, behind = view.visibility[list(_WRIST_MARKS)], np.array(hidden)
        mistaken = float((shown * behind + (1 - shown) * (1 - behind)).sum())
        metres = metres_of(view)
        otherwise = 0.0 if metres is None else misread(metres, seen.joints)
        against += float(np.dot(_AGAINST, np.array([*percents, mistaken, otherwise])))
        told.append(replace(seen, doubts=doubts_of(view, hidden)))
    return replace(fit, views=tuple(told)), against


def converge(solver: BodySolver, rounds: int = _ROUNDS) -> None:
    """Solve for all unknowns of views of at most FIGURE pixels: by landmarks, then by ``follow_outlines``."""
    solver.solve(10)
    solver.weigh_landmarks()
    solver.solve(5)
    follow_outlines(solver, rounds)


def follow_outlines(solver: BodySolver, rounds: int, moved: F64 | None = None) -> None:
    """Improve all unknowns by the masks' outlines, looked for so many times.

    ``moved`` [V, 3] metres is how far the surface lies off the bare body at rest, where that is known.
    """
    trust = _trust_of_parts(solver.body) if moved is None else np.ones(len(solver.body.vertices))
    cloth = np.where(arm_layers(solver.body) == 0, _CLOTH, solver.sleeve)
    for _ in range(rounds):
        for index, view in enumerate(solver.views):
            rim, weights = _pulled(_rim(solver.body, solver.posed(index), view, moved), trust, cloth, view)
            solver.pull_to(index, rim, moved, weights)
            if degrees_between(view.turn, 0.0) <= _FRONT and view.world is not None:  # from aside arms hide each other
                solver.keep_before(index, *_shown_arms(solver.body, solver.posed(index), view))
        solver.solve(2)
        solver.weigh_landmarks()


def strays_of(solver: BodySolver) -> list[float]:
    """Mean distance of each view's landmarks from where the body has them, in percent of the figure's height."""
    strays = []
    for index, view in enumerate(solver.views):
        away = solver.strayed(index, pixels=True) / view.figure * 100
        strays.append(float(np.linalg.norm(away, axis=1).mean()))
    return strays


def _trust_of_parts(body: Body) -> F64:
    """[V] how much clothes and hair let an outline say of the body beneath."""
    parts = dict.fromkeys(_FINGERS, 1.0) | _TRUST
    of_joint = [next((value for part, value in parts.items() if part in name), _CLOTHED) for name in JOINT_NAMES]
    return np.asarray(np.array(of_joint)[body.part])


def _rim(body: Body, posed: PosedBody, view: View, moved: F64 | None) -> Rim:
    where = posed.points(body.points(np.arange(len(body.vertices)), moved))
    pixels = projected(where, view.focal, view.centre)[0]
    reach = _REACH * view.figure
    rim, drawn = find_rim(body, where, pixels, view.mask, reach, _FLAT if moved is None else _FLAT_DRESSED)
    gaps = rim.gaps.copy()
    if moved is not None:  # bare legs do not meet, and hats have brims
        head = body.part[rim.vertices] == _HEAD
        gaps[head] = edge_distances(brimless(view.mask, view.figure), rim.pixels[head], rim.normals[head], reach)
        gaps = np.where(np.isfinite(gaps), gaps, half_gaps(view.mask, drawn, rim.pixels, rim.normals, reach))
    around = (_ARM_REACH if moved is None else _ARM_REACH_DRESSED) * view.figure
    column, row = np.floor(rim.pixels).astype(int).T
    by_arm = arm_layers(body)[rim.vertices] == 0
    by_arm &= beside_arms(body, pixels, view.mask.shape, around)[row, column]
    gaps[by_arm] = np.nan
    if moved is not None:  # before arms are in their place, sleeves would make somebody stout
        shown = view.mask & ~beside_arms(body, pixels, view.mask.shape, _ARM_EDGE * view.figure)
        gaps[by_arm] = lengths_inside(shown, rim.pixels[by_arm], rim.normals[by_arm], reach)
    found = np.isfinite(gaps)
    if moved is not None:  # the edge of a ball or a bag
        held = beside_arms(body, pixels, view.mask.shape, _HELD_REACH * view.figure, hands(body))[row, column]
        found &= ~(held & (gaps > _HELD * view.figure))
    return Rim(rim.vertices[found], rim.pixels[found], rim.normals[found], gaps[found])


def _shown_arms(body: Body, posed: PosedBody, view: View) -> tuple[NDArray[np.intp], F64]:
    """Vertices of forearms that are seen, and how deep the trunk behind them lets them be; see ``before_trunk``."""
    where = posed.points(body.points(np.arange(len(body.vertices))))
    pixels = projected(where, view.focal, view.centre)[0]
    return before_trunk(body, where, pixels, view.focal, view.mask.shape, view.visibility[list(_WRIST_MARKS)])


def _pulled(rim: Rim, trust: F64, cloth: F64, view: View) -> tuple[Rim, F64]:
    """At most _RIM_ROWS of a rim, evenly taken, and how much each counts."""
    some = np.unique(np.linspace(0, len(rim.vertices) - 1, min(_RIM_ROWS, len(rim.vertices))).astype(np.intp))
    rim = Rim(rim.vertices[some], rim.pixels[some], rim.normals[some], rim.gaps[some])
    share = rim.gaps / view.figure
    outside = trust[rim.vertices] / (1 + (share / cloth[rim.vertices]) ** 2)
    weight = np.where(share > 0, outside, 1.2 / (1 + (share / _INSIDE) ** 2))
    return rim, weight * _RIM_WORTH * 100 / view.figure / np.sqrt(max(len(some), 1))


def dressed(body: Body, bare: F64, poses: Sequence[PosedBody], views: Sequence[View], worn: F64 | None = None) -> F64:
    """[V] offsets in metres along ``outward`` of ``bare`` [V, 3], by which its outlines meet all masks at once.

    ``bare`` is of the poses' shape, in the zero pose; ``worn`` [V] are offsets that fitted it but for little.
    """
    small = [view.smaller(FIGURE) for view in views]
    directions = outward(body, bare)
    plain = (vertex_normals(bare, body.faces) * directions).sum(axis=1) > _PLAIN
    soles = soles_of(body)
    if len(views) > _FEW:
        plain &= ~face_of(body)
    offsets = np.zeros(len(bare)) if worn is None else worn
    for _ in range(_DRESSINGS if worn is None else 1):
        vertices, wanted = [], []
        for posed, view in zip(poses, small, strict=True):
            moved = bare - body.shaped(posed.betas)[0] + offsets[:, None] * directions
            rim = _rim(body, posed, view, moved)
            clear = plain[rim.vertices]
            vertices.append(rim.vertices[clear])
            wanted.append((offsets[rim.vertices] + rim.gaps * posed.joints[0, 2] / view.focal)[clear])
        known, far = np.concatenate(vertices), np.concatenate(wanted)
        if len(views) > _FEW:
            known, far = _agreed(known, far)
        offsets = smooth_offsets(body, known, far, np.ones(len(known)), offsets)
        if len(views) > _FEW:
            offsets = np.where(soles, np.minimum(offsets, _SOLE), offsets)
    return offsets


def _agreed(vertices: NDArray[np.intp], wanted: F64) -> tuple[NDArray[np.intp], F64]:
    """Each of the ``vertices`` [K] once, with the median of what is ``wanted`` [K] of it.

    The outlines of a whole turn pass over every fold, where some of them mistake one edge for another; and a vertex
    that is asked for ten times would not listen to its neighbours.
    """
    order = np.lexsort((wanted, vertices))
    known, first, count = np.unique(vertices[order], return_index=True, return_counts=True)
    sorted_by = wanted[order]
    return known, (sorted_by[first + (count - 1) // 2] + sorted_by[first + count // 2]) / 2


def assembled(
    body: Body,
    bare: F64,
    joints: F64,
    offsets: F64,
    poses: Sequence[PosedBody],
    rotations: Sequence[F64],
    views: Sequence[View],
    strays: Sequence[float],
) -> BodyFit:
    """The fit of a ``bare`` surface [V, 3] with its ``joints`` [55, 3] in the zero pose, and what each view shows."""
    betas = poses[0].betas
    rest = bare + offsets[:, None] * outward(body, bare)
    points = body.points(np.arange(len(bare)), rest - body.shaped(betas)[0])
    shaped = body.shaped(betas)[1]
    fitted, problems = [], []
    for posed, angles, view, stray in zip(poses, rotations, views, strays, strict=True):
        where = posed.points(points)
        pixels = projected(where, view.focal, view.centre)[0]
        met = overlap(projected_mask(pixels, body.faces, view.mask.shape), view.mask)
        place = posed.joints + np.einsum("jik,jk->ji", posed.frames, joints - shaped)
        fitted.append(FittedView(angles, posed.frames[0], place[0], place, where, pixels, met, stray))
        if not np.isfinite(where).all() or met < _GOOD[0]:
            problems.append(f"the body covers {met:.1%} of the person in the {view.side} picture, not {_GOOD[0]:.0%}")
        elif stray > _GOOD[1]:
            problems.append(f"the landmarks of the {view.side} picture lie {stray:.1f} % of the height off the body")
    size, grows = body.stature
    stature = float(size + grows @ betas)
    return BodyFit(betas.copy(), stature, offsets, rest, joints, tuple(fitted), "; ".join(problems))

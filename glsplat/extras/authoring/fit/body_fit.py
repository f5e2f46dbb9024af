"""Fit the open body's shape, pose and clothes to pictures of a person, and measure the fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F64
from glsplat.extras.authoring.body.open_body import Body, open_body
from glsplat.extras.authoring.body.segments import arm_layers, hand_weights
from glsplat.extras.authoring.compute.threads import map_threads
from glsplat.extras.authoring.fit.kinematics import PosedBody, projected
from glsplat.extras.authoring.fit.landmarks import landmarks
from glsplat.extras.authoring.fit.limbs import (
    before_trunk,
    distance_to_arms,
    hidden_arms,
    limb_uncertainty,
    missing_part,
)
from glsplat.extras.authoring.fit.offsets import face_vertices, offset_directions, smooth_offsets, sole_vertices
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
from glsplat.extras.authoring.fit.stances import MIN_ASIDE_RAD, arm_direction_error, stances_of, trusted_world
from glsplat.extras.authoring.fit.view import View
from glsplat.extras.authoring.networks.people import degrees_between
from glsplat.meshes import RiggedMesh, vertex_normals
from glsplat.skinning.pose import Pose
from glsplat.skinning.smplx import JOINT_NAMES

MAX_FIGURE_PX = 480.0
"""Height of the person in the fit's pictures, which are reduced to it."""

_OUTLINE_ROUNDS = 4  # searches for the outlines, each followed by a solve
_CLOTHES_ROUNDS = 5  # searches for the outlines, each followed by new offsets
_MAX_RIM_VERTICES = 500
_RIM_WEIGHT = 36.0  # of an outline, in independent measurements
_MANY_VIEWS = 5  # from there on outlines cross each other everywhere

# lengths as fractions of the person's height in the picture
_REACH_FRACTION = 0.04  # between the body and the mask's edge
_CLOTH_FRACTION, _INSIDE_FRACTION = 0.008, 0.03  # scales of the distances outside and inside the body
_ARM_REACH_FRACTION, _DRESSED_ARM_REACH_FRACTION = 0.015, 0.03  # the trunk's outlines are ignored so near an arm
_ARM_EDGE_FRACTION = 0.008  # farther from an arm the mask shows the trunk
_HAND_REACH_FRACTION, _MAX_HELD_FRACTION = 0.08, 0.025  # near a hand, larger offsets are held things, not cloth
_MAX_RIM_COSINE, _MAX_DRESSED_RIM_COSINE = 0.35, 0.22  # of normal and line of sight; cloth has sharper outlines
_MIN_PLAIN_COSINE = 0.8  # of normal and offset; vertices below it, in an ear's folds, follow their neighbours
# offsets kept and the fraction of more: at the sides, before and behind
_FREE_M, _STAND_OFF = (0.04, 0.015), (0.5, 0.3)
_MAX_SOLE_M = 0.020  # thickness; more would be height that the body lacks
_ELBOW_AND_WRIST_MARKS, _WRIST_MARKS = (13, 14, 15, 16), (15, 16)  # landmarks

# Penalties of a pose: a percent of the height of all landmarks' and of the arms' mean error, the arms' direction error,
# and an unusual stance; of its clothes: a percent of the mask uncovered, and an arm that is hidden but visible or the
# reverse. Tuned on eight synthetic people in nine poses.
_POSE_PENALTIES, _UNUSUAL_PENALTY, _DRESSED_PENALTIES = (2.0, 0.5, 12.0), 2.0, (1.0, 6.0)
_MAX_FRONT_TURN_DEG = 45.0  # of a person whose forearms are both in front of the trunk
_MIN_OVERLAP, _MAX_LANDMARK_ERROR_PERCENT = 0.88, 2.0  # of a good fit

# weight of outlines of the bare body, by parts of joints' names: clothes and hair hide it
_OUTLINE_TRUST = {
    **dict.fromkeys(("index", "middle", "pinky", "ring", "thumb", "wrist"), 1.0),
    **{"elbow": 1.0, "head": 0.35, "neck": 0.35, "jaw": 0.35, "foot": 0.5, "ankle": 0.5},
}
_CLOTHED_TRUST = 0.6
_HEAD = JOINT_NAMES.index("head")


@dataclass(frozen=True, eq=False)
class FittedView:
    """The body in one picture; OpenCV camera axes, metres."""

    rotations: F64  # [55, 3] axis-angle, radians; the root's row is zero, see ``root``
    root: F64  # [3, 3] the body's axes in the camera's
    pelvis: F64  # [3]
    joints: F64  # [55, 3]
    vertices: F64  # [V, 3] the dressed surface
    pixels: F64  # [V, 2] its projection
    overlap: float  # intersection over union of the dressed surface and the mask
    landmark_error: float  # mean distance of the body's landmarks from the network's, percent of the height
    uncertainty: Mapping[str, float] = field(default_factory=dict)  # by limb, 0 to 1; see ``limb_uncertainty``

    def moved(self, mesh: RiggedMesh, some: NDArray[np.bool_]) -> FittedView:
        """Return the view with ``some`` [V] vertices where ``mesh`` has them; pixels are unchanged."""
        there = mesh.posed(Pose(self.rotations)) - mesh.skeleton.joints[0]
        vertices = np.where(some[:, None], there @ self.root.T + self.pelvis, self.vertices)
        return replace(self, vertices=vertices)


@dataclass(frozen=True, eq=False)
class BodyFit:
    """The fitted person. ``problem`` is empty, or one line with the reason not to trust the fit."""

    betas: F64  # [10] shape
    stature: float  # metres, crown to sole without hair and shoes
    offsets: F64  # [V] metres along ``offset_directions`` in the zero pose: clothes and hair
    rest: F64  # [V, 3] the dressed surface in the zero pose
    joints: F64  # [55, 3] in the zero pose
    views: tuple[FittedView, ...]
    problem: str


def fit_body(views: Sequence[View], height: float | None = None) -> BodyFit:
    """Fit the open body to one or more pictures of one person; ``height`` is in metres, if known.

    The bare body is fitted to the landmarks, then to the outlines, where distances outside the body weigh little
    because of clothes. Then the surface moves along its normals until its outline meets the masks. Pictures share the
    shape and, up to a few degrees a joint, the pose. ``problem`` reports a fit that failed.
    """
    body = open_body()
    starts = map_threads(lambda stance: _posed_from(stance, views, height, body), stances_of(views[0], body))
    fit, _ = min(map_threads(lambda start: _dressed(start, views, body), starts), key=lambda found: found[1])
    lines = [missing_part(fitted.uncertainty, view.side) for fitted, view in zip(fit.views, views, strict=True)]
    missing = [line for line in lines if line]
    return replace(fit, problem="; ".join([fit.problem] * bool(fit.problem) + missing))


class _Posed(NamedTuple):
    """The bare body posed from one stance."""

    solver: BodySolver
    penalty: float  # of landmarks and stance: clothes only add to it


def _posed_from(stance: PosePrior, views: Sequence[View], height: float | None, body: Body) -> _Posed:
    """Return the bare body fitted with a prior of the pose."""
    solver = BodySolver(body, landmarks(), [view.smaller(MAX_FIGURE_PX) for view in views], height, stance=stance)
    converge(solver)
    usual = stance is POSED or abs(stance.turn) > MIN_ASIDE_RAD  # people who have turned aside do not pose
    penalty = 0.0 if usual else _UNUSUAL_PENALTY
    arm_rows = np.isin(solver.table.numbers, _ELBOW_AND_WRIST_MARKS)
    for index, (view, error) in enumerate(zip(views, landmark_errors(solver), strict=True)):
        arms = np.linalg.norm(solver.landmark_errors(index, pixels=True)[arm_rows], axis=1)
        world = trusted_world(view)
        direction_error = 0.0 if world is None else arm_direction_error(world, solver.posed(index).joints)
        percents = error, arms.mean() / solver.views[index].figure * 100
        penalty += float(np.dot(_POSE_PENALTIES, (*percents, direction_error)))
    return _Posed(solver, penalty)


def _dressed(start: _Posed, views: Sequence[View], body: Body) -> tuple[BodyFit, float]:
    """Return the fit with clothes, and its penalty."""
    solver, penalty = start
    poses = [solver.posed(index) for index in range(len(views))]
    rotations = [HINGES.rotations(solver.angles(index)) for index in range(len(views))]
    bare, joints = body.shaped(solver.betas)
    offsets = fit_clothes(body, bare, poses, views)
    fit = assemble_fit(body, bare, joints, offsets, poses, rotations, views, landmark_errors(solver))
    fitted_views = []
    for fitted, view in zip(fit.views, views, strict=True):
        hidden = hidden_arms(body, fitted.vertices, fitted.pixels, view.focal, view.mask.shape)
        visible, behind = view.visibility[list(_WRIST_MARKS)], np.array(hidden)
        contradictions = float((visible * behind + (1 - visible) * (1 - behind)).sum())
        penalty += float(np.dot(_DRESSED_PENALTIES, ((1 - fitted.overlap) * 100, contradictions)))
        fitted_views.append(replace(fitted, uncertainty=limb_uncertainty(view, hidden)))
    return replace(fit, views=tuple(fitted_views)), penalty


def converge(solver: BodySolver, rounds: int = _OUTLINE_ROUNDS) -> None:
    """Solve for all unknowns of views of at most MAX_FIGURE_PX by landmarks, then by ``follow_outlines``."""
    solver.solve(10)
    solver.weigh_landmarks()
    solver.solve(5)
    follow_outlines(solver, rounds)


def follow_outlines(solver: BodySolver, rounds: int, moved: F64 | None = None) -> None:
    """Improve all unknowns by the masks' outlines, which are searched in each of ``rounds``.

    ``moved`` [V, 3] metres is the surface's offset from the bare body at rest, if known.
    """
    trust = _outline_trust(solver.body) if moved is None else np.ones(len(solver.body.vertices))
    cloth = np.where(arm_layers(solver.body) == 0, _CLOTH_FRACTION, solver.sleeve)
    for _ in range(rounds):
        for index, view in enumerate(solver.views):
            rim, weights = _weighted(_rim(solver.body, solver.posed(index), view, moved), trust, cloth, view)
            solver.set_outline(index, rim, moved, weights)
            # arms hide each other from the side
            if degrees_between(view.turn, 0.0) <= _MAX_FRONT_TURN_DEG and view.world is not None:
                solver.keep_in_front(index, *_visible_forearms(solver.body, solver.posed(index), view))
        solver.solve(2)
        solver.weigh_landmarks()


def landmark_errors(solver: BodySolver) -> list[float]:
    """Return each view's mean distance of the body's landmarks from the network's, in percent of the height."""
    errors = []
    for index, view in enumerate(solver.views):
        away = solver.landmark_errors(index, pixels=True) / view.figure * 100
        errors.append(float(np.linalg.norm(away, axis=1).mean()))
    return errors


def _outline_trust(body: Body) -> F64:
    """Return the weights [V] of outlines for the bare body."""
    by_joint = [
        next((trust for part, trust in _OUTLINE_TRUST.items() if part in name), _CLOTHED_TRUST) for name in JOINT_NAMES
    ]
    return np.asarray(np.array(by_joint)[body.part])


def _rim(body: Body, posed: PosedBody, view: View, moved: F64 | None) -> Rim:
    """Return the rim of the body, or of the surface ``moved`` [V, 3] metres from it, with edges of the view's mask."""
    where = posed.points(body.points(np.arange(len(body.vertices)), moved))
    pixels = projected(where, view.focal, view.centre)[0]
    reach = _REACH_FRACTION * view.figure
    cosine = _MAX_RIM_COSINE if moved is None else _MAX_DRESSED_RIM_COSINE
    rim, drawn = find_rim(body, where, pixels, view.mask, reach, cosine)
    gaps = rim.gaps.copy()
    if moved is not None:  # bare legs do not meet, and hats have brims
        head = body.part[rim.vertices] == _HEAD
        gaps[head] = edge_distances(brimless(view.mask, view.figure), rim.pixels[head], rim.normals[head], reach)
        gaps = np.where(np.isfinite(gaps), gaps, half_gaps(view.mask, drawn, rim.pixels, rim.normals, reach))
    around = (_ARM_REACH_FRACTION if moved is None else _DRESSED_ARM_REACH_FRACTION) * view.figure
    column, row = np.floor(rim.pixels).astype(int).T
    by_arm = arm_layers(body)[rim.vertices] == 0
    from_arms = distance_to_arms(body, pixels, view.mask.shape)
    by_arm &= from_arms[row, column] <= around
    gaps[by_arm] = np.nan
    if moved is not None:  # before arms are in place, sleeves would make the trunk stout
        shown = view.mask & (from_arms > _ARM_EDGE_FRACTION * view.figure)
        gaps[by_arm] = lengths_inside(shown, rim.pixels[by_arm], rim.normals[by_arm], reach)
    ends = rim.pixels + rim.normals * gaps[:, None]
    found = ((ends >= 1) & (ends <= np.subtract(view.mask.shape[::-1], 1))).all(axis=1)  # where the picture ends
    if moved is not None:  # ignore edges of a held ball or bag
        hand_reach = _HAND_REACH_FRACTION * view.figure
        from_hands = distance_to_arms(body, pixels, view.mask.shape, hand_weights(body) > 0.5)
        near_hand = from_hands[row, column] <= hand_reach
        found &= ~(near_hand & (gaps > _MAX_HELD_FRACTION * view.figure))
    return Rim(rim.vertices[found], rim.pixels[found], rim.normals[found], gaps[found])


def _visible_forearms(body: Body, posed: PosedBody, view: View) -> tuple[NDArray[np.intp], F64]:
    """Return vertices of visible forearms and their largest depths; see ``before_trunk``."""
    where = posed.points(body.points(np.arange(len(body.vertices))))
    pixels = projected(where, view.focal, view.centre)[0]
    return before_trunk(body, where, pixels, view.focal, view.mask.shape, view.visibility[list(_WRIST_MARKS)])


def _weighted(rim: Rim, trust: F64, cloth: F64, view: View) -> tuple[Rim, F64]:
    """Return at most _MAX_RIM_VERTICES of a rim, evenly chosen, and their weights."""
    count = min(_MAX_RIM_VERTICES, len(rim.vertices))
    rows = np.unique(np.linspace(0, len(rim.vertices) - 1, count).astype(np.intp))
    rim = Rim(rim.vertices[rows], rim.pixels[rows], rim.normals[rows], rim.gaps[rows])
    share = rim.gaps / view.figure
    outside = trust[rim.vertices] / (1 + (share / cloth[rim.vertices]) ** 2)
    weight = np.where(share > 0, outside, 1.2 / (1 + (share / _INSIDE_FRACTION) ** 2))
    return rim, weight * _RIM_WEIGHT * 100 / view.figure / np.sqrt(max(len(rows), 1))


def fit_clothes(
    body: Body, bare: F64, poses: Sequence[PosedBody], views: Sequence[View], start: F64 | None = None
) -> F64:
    """Return offsets [V] in metres along ``offset_directions`` that move the outlines of ``bare`` to all masks.

    ``bare`` [V, 3] has the poses' shape, in the zero pose; ``start`` [V] are offsets of a similar fit.
    """
    small = [view.smaller(MAX_FIGURE_PX) for view in views]
    directions = offset_directions(body, bare)
    plain = (vertex_normals(bare, body.faces) * directions).sum(axis=1) > _MIN_PLAIN_COSINE
    soles = sole_vertices(body)
    many_views = len(views) >= _MANY_VIEWS
    if many_views:
        plain &= ~face_vertices(body)
    offsets = np.zeros(len(bare)) if start is None else start
    for _ in range(_CLOTHES_ROUNDS if start is None else 1):
        vertices, wanted = [], []
        for posed, view in zip(poses, small, strict=True):
            moved = bare - body.shaped(posed.betas)[0] + offsets[:, None] * directions
            rim = _rim(body, posed, view, moved)
            clear = plain[rim.vertices]
            vertices.append(rim.vertices[clear])
            wanted.append((offsets[rim.vertices] + rim.gaps * posed.joints[0, 2] / view.focal)[clear])
        known, far = np.concatenate(vertices), np.concatenate(wanted)
        if many_views:
            known, far = _medians(known, far)
        offsets = smooth_offsets(body, known, far, offsets)
        if many_views:
            offsets = np.where(soles, np.minimum(offsets, _MAX_SOLE_M), offsets)
    return _hung(body, offsets, directions) if len(views) == 1 else offsets


def _hung(body: Body, offsets: F64, directions: F64) -> F64:
    """Return ``offsets`` [V] of one picture's outline with less cloth before and behind: coats stand off to the sides.

    Raised arms and open coats make an outline wider than its person.
    """
    free, share = (near + (far - near) * np.abs(directions[:, 2]) for near, far in (_FREE_M, _STAND_OFF))
    off = np.maximum(offsets - free, 0) * (1 - share)
    trunk = [k for k, name in enumerate(JOINT_NAMES) if any(part in name for part in ("pelvis", "spine", "hip"))]
    return offsets - off * (body.skin_weights * np.isin(body.skin_joints, trunk)).sum(axis=1)


def _medians(vertices: NDArray[np.intp], wanted: F64) -> tuple[NDArray[np.intp], F64]:
    """Return the distinct ``vertices`` [K] and the median of the offsets ``wanted`` [K] for each.

    The outlines of a whole turn pass over every fold, and some take one edge for another. The sum of many wishes
    would also outweigh the vertex's neighbours.
    """
    order = np.lexsort((wanted, vertices))
    known, first, count = np.unique(vertices[order], return_index=True, return_counts=True)
    ordered = wanted[order]
    return known, (ordered[first + (count - 1) // 2] + ordered[first + count // 2]) / 2


def assemble_fit(
    body: Body,
    bare: F64,
    joints: F64,
    offsets: F64,
    poses: Sequence[PosedBody],
    rotations: Sequence[F64],
    views: Sequence[View],
    errors: Sequence[float],
) -> BodyFit:
    """Return the fit of a ``bare`` surface [V, 3] with its ``joints`` [55, 3] in the zero pose, and all views of it.

    ``errors`` are those of ``landmark_errors``.
    """
    betas = poses[0].betas
    rest = bare + offsets[:, None] * offset_directions(body, bare)
    points = body.points(np.arange(len(bare)), rest - body.shaped(betas)[0])
    shaped = body.shaped(betas)[1]
    fitted, problems = [], []
    for posed, angles, view, error in zip(poses, rotations, views, errors, strict=True):
        where = posed.points(points)
        pixels = projected(where, view.focal, view.centre)[0]
        covered = overlap(projected_mask(pixels, body.faces, view.mask.shape), view.mask)
        place = posed.joints + np.einsum("jik,jk->ji", posed.frames, joints - shaped)
        fitted.append(FittedView(angles, posed.frames[0], place[0], place, where, pixels, covered, error))
        if not np.isfinite(where).all() or covered < _MIN_OVERLAP:
            need = f"not {_MIN_OVERLAP:.0%}"
            problems.append(f"the body covers {covered:.1%} of the person in the {view.side} picture, {need}")
        elif error > _MAX_LANDMARK_ERROR_PERCENT:
            problems.append(f"the landmarks of the {view.side} picture lie {error:.1f} % of the height off the body")
    size, grows = body.stature
    stature = float(size + grows @ betas)
    return BodyFit(betas.copy(), stature, offsets, rest, joints, tuple(fitted), "; ".join(problems))

"""Skeleton: joints, parents and rest frames of any rig; forward kinematics in numpy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glsplat.arrays import Value, frozen, instance, own, own_whole, plain
from glsplat.errors import PoseError
from glsplat.rotations import rotation_matrices


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Skeleton(Value):
    """J joints. ``rest`` is the global frame of each joint in the zero pose.

    An SMPL-X rig has rest frames parallel to the world; other rigs may have any. Several roots are legal, a cycle,
    a parent out of range or a frame that cannot be inverted is a PoseError. The arrays are read-only copies.

    >>> skeleton = glsplat.Skeleton.from_joints(["hip", "knee"], parents=[-1, 0], joints=[[0, 1, 0], [0, 0.5, 0]])
    >>> skeleton.forward([[np.pi / 2, 0, 0], [0, 0, 0]])[1, :3, 3].round(3).tolist()  # the knee, the hip bent back
    [0.0, 1.0, -0.5]
    """

    names: tuple[str, ...]
    parents: NDArray[np.int32]  # [J] index of the parent, -1 for a root
    rest: NDArray[np.float64]  # [J, 4, 4] world from joint at the zero pose
    inverse_bind: NDArray[np.float64]  # [J, 4, 4] joint from world when it was bound
    _local: NDArray[np.float64] = field(init=False, repr=False)  # [J, 4, 4] rest frame in the parent's
    _levels: list[tuple[NDArray[np.intp], NDArray[np.int32]]] = field(
        init=False, repr=False
    )  # joints by depth, parents

    def __init__(
        self,
        names: Sequence[str],
        parents: ArrayLike,  # [J]
        rest: ArrayLike,  # [J, 4, 4]
        inverse_bind: ArrayLike | None = None,  # [J, 4, 4]; None: the inverses of rest
    ) -> None:
        listed = isinstance(names, Sequence) and not isinstance(names, str)
        if not listed or not all(isinstance(name, str) for name in names):
            raise PoseError("a skeleton needs its joints' names as a sequence of text")
        names, count = tuple(names), len(names)
        parents = own_whole(parents, np.int32, "parents", PoseError)
        rest = own(rest, np.float64, "rest", PoseError)
        if count < 1 or parents.shape != (count,) or rest.shape != (count, 4, 4):
            raise PoseError(
                f"a skeleton of {count} joints needs parents ({count},) and rest ({count}, 4, 4), "
                f"not {parents.shape} and {rest.shape}"
            )
        if len(set(names)) != count:
            raise PoseError("joint names need to be distinct")
        if not np.isfinite(rest).all():
            raise PoseError("rest frames need finite numbers, found NaN or infinity")
        if np.abs(rest[:, 3] - (0, 0, 0, 1)).max() > 1e-4:
            raise PoseError("rest frames need the last row 0 0 0 1 (translation in the last column); transpose them")
        try:
            inverse_rest: NDArray[np.float64] = np.linalg.inv(rest).astype(np.float64)
        except np.linalg.LinAlgError:
            raise PoseError("a rest frame has no inverse (a zero scale?)") from None
        given = None if inverse_bind is None else own(inverse_bind, np.float64, "inverse_bind", PoseError)
        inverse = given if given is not None and given.size else frozen(inverse_rest)
        if inverse.shape != (count, 4, 4) or not np.isfinite(inverse).all():
            raise PoseError(f"inverse_bind needs finite numbers of shape ({count}, 4, 4), not {inverse.shape}")
        levels = _levels(parents)
        local = rest.copy()
        child = parents >= 0
        local[child] = inverse_rest[parents[child]] @ rest[child]
        self._keep(names=names, parents=parents, rest=rest, inverse_bind=inverse)
        self._keep(_local=frozen(local), _levels=[(ids, parents[ids]) for ids in levels])

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.names, self.parents, self.rest, self.inverse_bind)

    def __repr__(self) -> str:
        shown = ", ".join(self.names[:3]) + (", ..." if len(self) > 3 else "")
        return f"Skeleton({len(self)} joints: {shown:.60})"

    @classmethod
    def from_joints(cls, names: Sequence[str], parents: ArrayLike, joints: ArrayLike) -> Skeleton:
        """Return a rig whose rest frames are parallel to the world (SMPL-X); ``joints`` [J, 3] in metres."""
        positions = plain(joints, "joints", PoseError)
        if positions.ndim != 2 or positions.shape[1] != 3:
            raise PoseError(f"joints need shape (J, 3), not {positions.shape}")
        rest = np.tile(np.eye(4), (len(positions), 1, 1))
        rest[:, :3, 3] = positions
        return cls(names, parents, rest)

    def __len__(self) -> int:
        return len(self.names)

    def same(self, other: Skeleton) -> bool:
        """Return whether names and parents are equal, and frames to float32: poses then mean the same."""
        if self is other:
            return True
        instance(other, Skeleton, "same()", PoseError)
        if self.names != other.names or not np.array_equal(self.parents, other.parents):
            return False
        pairs = ((self.rest, other.rest), (self.inverse_bind, other.inverse_bind))
        return all(np.allclose(a, b, rtol=1e-5, atol=1e-6) for a, b in pairs)

    @property
    def joints(self) -> NDArray[np.float64]:
        """Rest positions [J, 3] in metres."""
        return self.rest[:, :3, 3]

    def under(self, name: str) -> NDArray[np.bool_]:
        """Return [J] True for the joint of that name and its descendants. Raises PoseError where there is none."""
        if not isinstance(name, str) or name not in self.names:
            raise PoseError(f'this skeleton has no joint "{name!s:.40}"; it has {", ".join(self.names[:6])}, ...')
        found = np.arange(len(self)) == self.names.index(name)
        for ids, parents in self._levels[1:]:  # roots first
            found[ids] |= found[parents]
        return found

    def forward(
        self,
        rotations: ArrayLike,  # [J, 3] axis-angle (radians), or [J, 3, 3] matrices, in each joint's rest frame
        trans: ArrayLike = (0.0, 0.0, 0.0),  # [3] metres, moves the roots
        translations: ArrayLike | None = None,  # [J, 3] metres in the parent's frame, added to the rest offset
    ) -> NDArray[np.float64]:
        """Return the global joint frames [J, 4, 4] of a pose: G_j = G_parent L_j R_j, level by level."""
        rot = plain(rotations, "rotations", PoseError)
        if rot.shape == (len(self), 3):
            rot = rotation_matrices(rot)
        if rot.shape != (len(self), 3, 3):
            raise PoseError(f"this skeleton needs {len(self)} joint rotations, not shape {rot.shape}")
        local = self._local.copy()
        local[:, :3, :3] = local[:, :3, :3] @ rot
        if translations is not None:
            offsets = plain(translations, "translations", PoseError)
            if offsets.shape != (len(self), 3):
                raise PoseError(f"translations need shape ({len(self)}, 3), not {offsets.shape}")
            local[:, :3, 3] += offsets
        moved = plain(trans, "trans", PoseError)
        if moved.shape != (3,):
            raise PoseError(f"trans needs shape (3,), not {moved.shape}")
        out = local
        for level, (ids, parents) in enumerate(self._levels):
            if level == 0:
                out[ids, :3, 3] += moved
            else:
                out[ids] = out[parents] @ local[ids]
        return out

    def bone_matrices(
        self, rotations: ArrayLike, trans: ArrayLike = (0.0, 0.0, 0.0), translations: ArrayLike | None = None
    ) -> NDArray[np.float64]:
        """Return skinning matrices [J, 3, 4]: posed joint frame times inverse bind (glTF 2.0, section 3.7.3.3)."""
        return (self.forward(rotations, trans, translations) @ self.inverse_bind)[:, :3, :]


def _levels(parents: NDArray[np.int32]) -> list[NDArray[np.intp]]:
    """Return joint indices by depth, roots first. Raises PoseError for cycles and parents out of range."""
    count = len(parents)
    if (parents >= count).any() or (parents < -1).any():
        raise PoseError(f"parents need to lie in -1..{count - 1}, found {parents.min()}..{parents.max()}")
    children: list[list[int]] = [[] for _ in range(count)]
    level: list[int] = []
    for joint, parent in enumerate(parents.tolist()):
        (children[parent] if parent >= 0 else level).append(joint)
    if not level:
        raise PoseError("a skeleton needs a root (a parent of -1), found none")
    levels, found = [], np.zeros(count, np.bool_)
    while level:
        levels.append(np.array(sorted(level), np.intp))
        found[levels[-1]] = True
        level = [child for joint in level for child in children[joint]]
    if not found.all():
        raise PoseError(f"the skeleton has a cycle through joint {int(np.flatnonzero(~found)[0])}")
    return levels

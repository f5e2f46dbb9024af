"""Pose: the joint rotations of one moment, from and to the pose objects of docs/conventions.md."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glsplat.arrays import Value, count, instance, own, plain
from glsplat.errors import PoseError
from glsplat.skinning.driven import why_not_driven
from glsplat.skinning.expression import checked_expression
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES, POSE_KEYS, SMPLX_NAMES

EXPRESSION = "expression"
"""Key of a pose object, of a tracking sample and of a request: weights by name, or 52 in ARKit's order."""

_COUNT = len(JOINT_NAMES)
_MAX_VALUE = 1e6  # metres, radians; more is a mistake of units
_MAX_ANGLE_RAD = 20 * np.pi  # ten turns; a right angle in degrees is more
_MAX_FILE_ANGLE_RAD = 4 * np.pi  # an angle beyond two turns in a file was meant in degrees


@dataclass(frozen=True, slots=True, eq=False, init=False, repr=False)
class Pose(Value):
    """Rotations of the J joints of a skeleton. The zero pose (all zeros) is that of ``Skeleton.rest``.

    Takes anything that numpy reads as numbers, checks it and keeps read-only copies. Raises PoseError.

    >>> glsplat.Pose.from_smplx({"global_orient": [0, 0.5, 0], "transl": [0, 0, 1]})
    Pose(55 joints, 1 turned, trans (0, 0, 1))
    """

    rotations: NDArray[np.float64]  # [J, 3] axis-angle, radians, in each joint's rest frame
    trans: NDArray[np.float64]  # [3] metres, moves the roots
    translations: NDArray[np.float64] | None = None  # [J, 3] metres added to rest offsets; for rigs that stretch
    expression: Mapping[str, float] = field(default_factory=dict)  # weights of an avatar's shapes by name, 0 left out

    def __init__(
        self,
        rotations: ArrayLike,  # [J, 3]
        trans: ArrayLike = (0.0, 0.0, 0.0),  # [3]
        translations: ArrayLike | None = None,  # [J, 3]
        expression: Mapping[str, float] | ArrayLike | None = None,  # by name, or 52 in ARKit's order
    ) -> None:
        turned, moved = own(rotations, np.float64, "rotations", PoseError), own(trans, np.float64, "trans", PoseError)
        if turned.ndim != 2 or turned.shape[1] != 3 or moved.shape != (3,):
            raise PoseError(f"a pose needs rotations (J, 3) and trans (3,), not {turned.shape} and {moved.shape}")
        stretched = None if translations is None else own(translations, np.float64, "translations", PoseError)
        if stretched is not None and stretched.shape != turned.shape:
            raise PoseError(f"translations need one row a joint, {turned.shape}, not {stretched.shape}")
        # 1e300 is finite, its square is not
        for name, value in (("trans", moved), ("a rotation", turned), ("translations", stretched)):
            most = 0.0 if value is None else float(np.abs(value).max(initial=0.0))
            if not isfinite(most):  # the largest of numbers with a NaN is NaN
                raise PoseError("a pose needs finite numbers, found NaN or infinity")
            if most > _MAX_VALUE:
                unit = "radians" if name == "a rotation" else "metres"
                raise PoseError(f"{name} needs {unit} below {_MAX_VALUE:g}, not {most:g}")
        if (angle := float(np.abs(turned).max(initial=0.0))) > _MAX_ANGLE_RAD:
            joint = int(np.abs(turned).max(axis=1).argmax())
            raise _degrees(f"joint {joint}", angle)
        self._keep(rotations=turned, trans=moved, translations=stretched, expression=checked_expression(expression))

    def __reduce__(self) -> tuple[Any, ...]:
        restore, (kind, values) = Value.__reduce__(self)  # slots=True makes super() fail
        return restore, (kind, values | {"expression": dict(self.expression)})  # a mapping proxy cannot be pickled

    def __repr__(self) -> str:
        turned = int(self.rotations.any(axis=1).sum())
        x, y, z = self.trans
        more = "" if self.translations is None else ", with translations"
        more += f", {len(self.expression)} shapes" if self.expression else ""
        return f"Pose({len(self.rotations)} joints, {turned} turned, trans ({x:.4g}, {y:.4g}, {z:.4g}){more})"

    @classmethod
    def zero(cls, joints: int = _COUNT) -> Pose:
        """Return the rest pose of a rig of that many joints."""
        if count(joints, "the number of joints", PoseError) < 0:
            raise PoseError(f"a rig has no {joints} joints")
        return cls(np.zeros((joints, 3)))

    @classmethod
    def from_smplx(cls, data: Mapping[str, Any]) -> Pose:
        """Parse a pose object with any of the keys root_pose, trans, body_pose, jaw_pose, ... (missing = zero).

        SMPL-X's own names are read too (global_orient, transl, left_hand_pose, right_hand_pose). Arrays may be nested
        (21, 3), flat (63) or a batch of one (1, 63). Other keys are ignored (LHM files carry betas, focal and more).
        Raises PoseError for an object with none of the keys, two names of one key, wrong counts or non-finite numbers.
        """
        if not isinstance(data, Mapping):
            raise PoseError(f"a pose is a mapping of {', '.join(POSE_KEYS)}, not {type(data).__name__}")
        for name, key in SMPLX_NAMES.items():
            if name in data and key in data:
                raise PoseError(f"a pose has {name} and {key}, which are the same thing; leave one out")
        data = {SMPLX_NAMES.get(name, name): value for name, value in data.items()}
        if not any(key in data for key in (*POSE_KEYS, "trans", EXPRESSION)):
            raise PoseError(f"a pose needs at least one of {', '.join(POSE_KEYS)}, trans; found {_some(data)}")
        rotations = np.zeros((_COUNT, 3))
        for key, joints in POSE_KEYS.items():
            if key in data:
                rotations[joints] = _numbers(data[key], key, joints.stop - joints.start)
        trans = _numbers(data.get("trans", (0, 0, 0)), "trans", 1)[0]
        return cls(rotations, trans, expression=data.get(EXPRESSION))

    @classmethod
    def from_json(cls, data: Any, skeleton: Skeleton) -> Pose:
        """Parse a pose object: SMPL-X keys, or {"joints": {NAME: [3]}, "translations": {NAME: [3]}}."""
        if not isinstance(data, Mapping):
            raise PoseError(f"a pose is a JSON object, not {type(data).__name__}")
        instance(skeleton, Skeleton, "from_json()", PoseError, "an avatar has one: avatar.skeleton")
        if "joints" not in data and "translations" not in data:
            if why := why_not_driven(skeleton):
                raise PoseError(f'this avatar takes poses {{"joints": {{NAME: [x, y, z]}}}} only: {why}')
            return cls.from_smplx(data)
        index = {name: i for i, name in enumerate(skeleton.names)}
        arrays = {"joints": np.zeros((len(skeleton), 3)), "translations": np.zeros((len(skeleton), 3))}
        for key, array in arrays.items():
            entries = data.get(key, {})
            if not isinstance(entries, Mapping):
                raise PoseError(f'"{key}" is an object of joint names, not {type(entries).__name__}')
            for name, value in entries.items():
                if name not in index:
                    raise PoseError(f'no joint "{name}"; this avatar has {_some(skeleton.names)}')
                array[index[name]] = _numbers(value, name, 1)[0]
                if key == "joints" and (angle := float(np.abs(array[index[name]]).max())) > _MAX_ANGLE_RAD:
                    raise _degrees(name, angle)
        trans = _numbers(data.get("trans", (0, 0, 0)), "trans", 1)[0]
        stretched = arrays["translations"] if data.get("translations") else None
        return cls(arrays["joints"], trans, stretched, data.get(EXPRESSION))

    def to_smplx(self) -> dict[str, Any]:
        """Return the pose object of docs/conventions.md; only for the 55 joints of SMPL-X."""
        if len(self.rotations) != _COUNT:
            raise PoseError(f"an SMPL-X pose has {_COUNT} joints, not {len(self.rotations)}")
        out: dict[str, Any] = {"trans": self.trans.tolist()}
        for key, joints in POSE_KEYS.items():
            value = self.rotations[joints]
            out[key] = value[0].tolist() if len(value) == 1 else value.tolist()
        if self.expression:
            out[EXPRESSION] = dict(self.expression)
        return out

    def bones(self, skeleton: Skeleton) -> NDArray[np.float64]:
        """Return the skinning matrices [J, 3, 4] of this pose on ``skeleton``."""
        instance(skeleton, Skeleton, "bones()", PoseError, "an avatar has one: avatar.skeleton")
        return skeleton.bone_matrices(self.rotations, self.trans, self.translations)


def _degrees(name: str, angle: float) -> PoseError:
    return PoseError(f"{name} turns by {angle:.0f} rad; angles are radians, not degrees (np.radians)")


def load_pose(path: str | Path, skeleton: Skeleton) -> Pose:
    """Read one pose file (JSON, either layout). Raises PoseError naming the file; also for angles in degrees."""
    try:
        pose = Pose.from_json(json.loads(Path(path).read_text(encoding="utf-8")), skeleton)
        angles = np.linalg.norm(pose.rotations, axis=1)
        if angles.max(initial=0) > _MAX_FILE_ANGLE_RAD:
            name, angle = skeleton.names[int(angles.argmax())], angles.max()
            raise _degrees(name, angle)
        return pose
    except OSError as error:
        raise PoseError(f"{path}: cannot read the pose ({error.strerror})") from None
    except (ValueError, RecursionError) as error:
        raise PoseError(f"{path}: a pose file is JSON, but {error}") from None
    except PoseError as error:
        raise PoseError(f"{path}: {error}") from None


def _numbers(value: Any, key: str, joints: int) -> NDArray[np.float64]:
    array = plain(value, key, PoseError)
    while array.ndim > 1 and array.shape[0] == 1 and array.shape != (joints, 3):
        array = array[0]  # a batch of one, as the body model returns it
    if array.shape not in ((joints, 3), (3 * joints,)):
        components = "; the components of a hand's PCA are no rotations" if key.endswith("hand_pose") else ""
        raise PoseError(f"{key} needs {joints} x 3 numbers, found shape {np.shape(value)}{components}")
    if not np.isfinite(array).all():
        raise PoseError(f"{key} needs finite numbers, found NaN or infinity")
    return array.reshape(joints, 3).astype(np.float64)


def _some(names: Any, limit: int = 6) -> str:
    listed = [str(name)[:24] for name in names]
    return ", ".join(listed[:limit]) + (", ..." if len(listed) > limit else "") or "nothing"

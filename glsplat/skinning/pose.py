"""Pose: the joint rotations of one moment, from and to the pose objects of docs/conventions.md."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import PoseError
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES, POSE_KEYS

__all__ = ["Pose", "load_pose"]

_COUNT = len(JOINT_NAMES)
_LIMIT = 1e6  # metres, radians; more is a mistake of units
_DEGREES = 4 * np.pi  # radians; an angle beyond two turns in a file was meant in degrees


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """Rotations of the J joints of a skeleton. The zero pose (all zeros) is the bind pose."""

    rotations: NDArray[np.float64]  # [J, 3] axis-angle, radians, in each joint's rest frame
    trans: NDArray[np.float64]  # [3] metres, moves the roots
    translations: NDArray[np.float64] | None = None  # [J, 3] metres added to rest offsets; for rigs that stretch

    def __post_init__(self) -> None:
        if self.rotations.ndim != 2 or self.rotations.shape[1] != 3 or self.trans.shape != (3,):
            raise PoseError(f"a pose needs rotations (J, 3) and trans (3,), not {self.rotations.shape}")
        values = [self.rotations, self.trans] + ([] if self.translations is None else [self.translations])
        if not all(np.isfinite(v).all() for v in values):
            raise PoseError("a pose needs finite numbers, found NaN or infinity")
        # 1e300 is finite, its square is not
        for name, value in (("trans", self.trans), ("a rotation", self.rotations), ("translations", self.translations)):
            most = 0.0 if value is None else np.abs(value).max(initial=0.0)
            if most > _LIMIT:
                unit = "radians" if name == "a rotation" else "metres"
                raise PoseError(f"{name} needs {unit} below {_LIMIT:g}, not {most:g}")

    @classmethod
    def zero(cls, joints: int = _COUNT) -> Pose:
        """The bind pose of a rig of that many joints."""
        return cls(np.zeros((joints, 3)), np.zeros(3))

    @classmethod
    def from_smplx(cls, data: Mapping[str, Any]) -> Pose:
        """A pose object with any of the keys root_pose, trans, body_pose, jaw_pose, ... (missing = zero).

        Lists may be nested (21, 3) or flat (63). Other keys are ignored (LHM files carry betas, focal and more);
        an object with none of the keys, wrong counts or non-finite numbers is a PoseError.
        """
        if not any(key in data for key in POSE_KEYS):
            raise PoseError(f"a pose needs at least one of {', '.join(POSE_KEYS)}; found {_some(data)}")
        rotations = np.zeros((_COUNT, 3))
        for key, joints in POSE_KEYS.items():
            if key in data:
                rotations[joints] = _numbers(data[key], key, joints.stop - joints.start)
        return cls(rotations, _numbers(data.get("trans", (0, 0, 0)), "trans", 1)[0])

    @classmethod
    def from_json(cls, data: Any, skeleton: Skeleton) -> Pose:
        """A pose object of either layout: SMPL-X keys, or {"joints": {NAME: [3]}, "translations": {NAME: [3]}}."""
        if not isinstance(data, Mapping):
            raise PoseError(f"a pose is a JSON object, not {type(data).__name__}")
        if "joints" not in data and "translations" not in data:
            if skeleton.names != JOINT_NAMES:
                raise PoseError('this avatar has another rig than SMPL-X; its poses are {"joints": {NAME: [x, y, z]}}')
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
        trans = _numbers(data.get("trans", (0, 0, 0)), "trans", 1)[0]
        return cls(arrays["joints"], trans, arrays["translations"] if data.get("translations") else None)

    def to_smplx(self) -> dict[str, list[Any]]:
        """The pose object of docs/conventions.md; only for the 55 joints of SMPL-X."""
        if len(self.rotations) != _COUNT:
            raise PoseError(f"an SMPL-X pose has {_COUNT} joints, not {len(self.rotations)}")
        out: dict[str, list[Any]] = {"trans": self.trans.tolist()}
        for key, joints in POSE_KEYS.items():
            value = self.rotations[joints]
            out[key] = value[0].tolist() if len(value) == 1 else value.tolist()
        return out

    def bones(self, skeleton: Skeleton) -> NDArray[np.float64]:
        """Skinning matrices [J, 3, 4] of this pose on ``skeleton``."""
        return skeleton.bone_matrices(self.rotations, self.trans, self.translations)


def load_pose(path: str | Path, skeleton: Skeleton) -> Pose:
    """Read one pose file (JSON, either layout). Raises PoseError naming the file; also for angles in degrees."""
    try:
        pose = Pose.from_json(json.loads(Path(path).read_text(encoding="utf-8")), skeleton)
        angles = np.linalg.norm(pose.rotations, axis=1)
        if angles.max(initial=0) > _DEGREES:
            name, angle = skeleton.names[int(angles.argmax())], angles.max()
            raise PoseError(f"{name} turns by {angle:.0f} rad; angles are radians, not degrees")
        return pose
    except OSError as error:
        raise PoseError(f"{path}: cannot read the pose ({error.strerror})") from None
    except (ValueError, RecursionError) as error:
        raise PoseError(f"{path}: a pose file is JSON, but {error}") from None
    except PoseError as error:
        raise PoseError(f"{path}: {error}") from None


def _numbers(value: Any, key: str, joints: int) -> NDArray[np.float64]:
    try:
        array = np.asarray(value, np.float64)
    except (TypeError, ValueError):
        raise PoseError(f"{key} needs {joints} x 3 numbers") from None
    if array.size != 3 * joints or array.ndim > 2:
        raise PoseError(f"{key} needs {joints} x 3 numbers, found shape {array.shape}")
    if not np.isfinite(array).all():
        raise PoseError(f"{key} needs finite numbers, found NaN or infinity")
    return array.reshape(joints, 3)


def _some(names: Any, limit: int = 6) -> str:
    listed = [str(name)[:24] for name in names]
    return ", ".join(listed[:limit]) + (", ..." if len(listed) > limit else "") or "nothing"

"""Splats and avatars for a test page without loss: exact float32 arrays, as draw/drawing.js takes them."""

from __future__ import annotations

from typing import Any

import numpy as np

from glsplat.avatar import Avatar
from glsplat.camera import Camera
from glsplat.skinning.pose import Pose
from glsplat.splats import Splats

__all__ = ["camera_file", "exported", "posed"]


def exported(content: Splats | Avatar) -> tuple[dict[str, Any], bytes]:
    """(header, bytes): arrays by name with type and place in the bytes, and the skeleton."""
    splats = content.splats if isinstance(content, Avatar) else content
    arrays: dict[str, np.ndarray] = {
        "means": splats.means,
        "quats": splats.quats,
        "scales": splats.scales,
        "opacities": splats.opacities,
        "sh": splats.sh.reshape(len(splats), -1),
    }
    header: dict[str, Any] = {
        "count": len(splats),
        "degree": splats.sh_degree,
        "antialias": splats.antialias,
        "skeleton": None,
    }
    if splats.surface is not None:
        arrays["normals"], arrays["occlusion"] = splats.surface.normals, splats.surface.occlusion
        arrays["shade"] = splats.surface.shades_or_one()
    if isinstance(content, Avatar):
        arrays["joints"], arrays["weights"] = content.skin.joints.astype(np.uint16), content.skin.weights
        rig = content.skeleton
        header["influences"] = content.skin.influences
        header["skeleton"] = {
            "names": list(rig.names),
            "parents": rig.parents.tolist(),
            "rest": rig.rest[:, :3].ravel().tolist(),
            "inverseBind": rig.inverse_bind[:, :3].ravel().tolist(),
        }
        if content.shapes is not None:
            shapes = content.shapes
            arrays["starts"], arrays["texels"] = shapes.starts.astype(np.uint32), shapes.texels()
            header["shapes"] = {"sizes": shapes.sizes.tolist(), "names": list(shapes.names)}
    body, header["arrays"] = b"", {}
    for name, array in arrays.items():
        data = np.ascontiguousarray(
            array if array.dtype in (np.uint16, np.uint32, np.int8, np.uint8) else array.astype(np.float32)
        )
        header["arrays"][name] = [str(data.dtype), len(body), data.size]
        body += data.tobytes() + bytes(-data.nbytes % 4)
    return header, body


def posed(pose: Pose) -> dict[str, Any]:
    """A pose for Drawing.pose: rotation vectors, root."""
    stretched = None if pose.translations is None else pose.translations.ravel().tolist()
    return {"vectors": pose.rotations.ravel().tolist(), "root": pose.trans.tolist(), "translations": stretched}


def camera_file(camera: Camera) -> dict[str, Any]:
    """The object of a camera file."""
    return {
        "width": camera.width,
        "height": camera.height,
        "fx": camera.K[0, 0],
        "fy": camera.K[1, 1],
        "cx": camera.K[0, 2],
        "cy": camera.K[1, 2],
        "w2c": camera.viewmat.tolist(),
    }

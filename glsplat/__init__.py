"""glsplat: animatable 3D Gaussian avatars on plain OpenGL, both eyes in one pass.

::

    avatar = glsplat.load("me.glb")                      # or glsplat.default_avatar()
    with glsplat.Renderer(avatar, size=(1024, 1024), views=2) as renderer:
        eyes = glsplat.stereo_cameras(head_pose, ipd=0.063, size=(1024, 1024))
        image = renderer.render(eyes, pose)              # (2, 1024, 1024, 4)
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from glsplat.avatar import Avatar
    from glsplat.camera import Camera, look_at, pinhole, stereo_cameras
    from glsplat.config import RenderConfig
    from glsplat.data import default_avatar
    from glsplat.errors import GlsplatError
    from glsplat.formats.registry import save
    from glsplat.gl.context import create_context
    from glsplat.meshes import RiggedMesh
    from glsplat.pictures import straight
    from glsplat.renderer import Renderer
    from glsplat.scene import Item, Scene, similarity
    from glsplat.scenes.loading import load
    from glsplat.skinning.pose import Pose
    from glsplat.skinning.shapes import Shapes
    from glsplat.skinning.skeleton import Skeleton
    from glsplat.skinning.skin import Skin
    from glsplat.splats import Splats

__version__ = "0.1.0"

__all__ = [
    "Avatar",
    "Camera",
    "GlsplatError",
    "Item",
    "Pose",
    "RenderConfig",
    "Renderer",
    "RiggedMesh",
    "Scene",
    "Shapes",
    "Skeleton",
    "Skin",
    "Splats",
    "create_context",
    "default_avatar",
    "load",
    "look_at",
    "pinhole",
    "save",
    "similarity",
    "stereo_cameras",
    "straight",
]

_HOME = {
    "Avatar": "avatar",
    "Camera": "camera",
    "GlsplatError": "errors",
    "Item": "scene",
    "Pose": "skinning.pose",
    "RenderConfig": "config",
    "Renderer": "renderer",
    "RiggedMesh": "meshes",
    "Scene": "scene",
    "Shapes": "skinning.shapes",
    "Skeleton": "skinning.skeleton",
    "Skin": "skinning.skin",
    "Splats": "splats",
    "create_context": "gl.context",
    "default_avatar": "data",
    "load": "scenes.loading",
    "look_at": "camera",
    "pinhole": "camera",
    "save": "formats.registry",
    "similarity": "scene",
    "stereo_cameras": "camera",
    "straight": "pictures",
}


def on_demand(package: str, homes: Mapping[str, str]) -> Callable[[str], object]:
    """A package's ``__getattr__`` (PEP 562) that loads a name's module, as ``homes`` has it, once it is asked for.

    Who needs one module loads that one: tracking and the wire protocol are usable without OpenGL.
    """

    def found(name: str) -> object:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(import_module(f"{package}.{homes[name]}"), name)
        setattr(sys.modules[package], name, value)
        return value

    return found


__getattr__ = on_demand(__name__, _HOME)

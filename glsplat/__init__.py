"""glsplat: animatable 3D Gaussian avatars on plain OpenGL, both eyes in one pass.

::

    avatar = glsplat.load("me.glb")                      # or glsplat.default_avatar()
    with glsplat.Renderer(avatar, size=(1024, 1024), views=2) as renderer:
        eyes = glsplat.stereo_cameras(head_pose, ipd=0.063, size=(1024, 1024))
        image = renderer.render(eyes, pose)              # (2, 1024, 1024, 4)
"""

import lazy_loader

__version__ = "0.1.0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

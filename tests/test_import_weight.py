"""What heavy libraries an import brings along: only those that the task needs. Serving has its own rows elsewhere."""

from __future__ import annotations

import subprocess
import sys

import pytest

HEAVY = (
    "cv2",
    "trimesh",
    "scipy",
    "matplotlib",
    "PIL",
    "aiohttp",
    "simplejpeg",
    "glfw",
    "moderngl",
    "cryptography",
    "segno",
    "numba",
)

NEEDED = {
    "import glsplat": set(),
    "from glsplat import load, save": set(),
    "from glsplat import Avatar, Camera, Item, Pose, Scene, Skeleton, Skin, Splats": set(),
    "from glsplat import default_avatar; default_avatar()": set(),
    "from glsplat import Renderer": {"moderngl"},
    "import glsplat.motion.loading": set(),
    "import glsplat.tracking.tracker": set(),
    "import glsplat.scenes.scene_file": set(),
    "import glsplat.net.messages": set(),
    "from glsplat.net.client import Client": {"aiohttp", "simplejpeg"},
    "import glsplat.authoring.posed": set(),
    "import glsplat.authoring.cones": {"cv2", "scipy"},
    "import glsplat.authoring.reconstruct.photos": {"cv2", "scipy", "simplejpeg"},  # of scipy where its OpenBLAS lies
    "import glsplat.authoring.reconstruct.builtin": {
        "PIL",
        "cv2",
        "scipy",
        "trimesh",
    },  # for no numba is waited
    "import apps.args": set(),
    "import apps.convert": set(),
    "import apps.inspect": set(),
    "import apps.render": {"moderngl", "cv2"},  # cv2 writes PNG and clips
}


@pytest.mark.parametrize("statement", NEEDED)
def test_only_what_is_needed_is_imported(statement: str) -> None:
    code = f"{statement}\nimport sys; print(*({set(HEAVY)!r} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert set(done.stdout.split()) == NEEDED[statement]


def test_motions_of_every_kind_need_no_scipy() -> None:
    code = (
        "import sys, glsplat, numpy as np\n"
        "from glsplat.motion.loading import embedded_motions, load_motion\n"
        "skeleton = glsplat.default_avatar().skeleton\n"
        "for name in embedded_motions():\n"
        "    motion = load_motion(name, skeleton)\n"
        "    motion.at(0.37), motion.resampled(11.0)\n"
        "assert len(embedded_motions()) > 1 and 'scipy' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_photograph_is_looked_at_before_all_is_imported_that_makes_an_avatar_of_it() -> None:
    code = (
        "import sys, apps.cli\n"
        "apps.cli.parsed('avatar', ['photo', 'me.jpg', '-o', 'me.glb'])\n"
        "print(*({'trimesh', 'numba', 'moderngl', 'scipy.optimize', 'glsplat.authoring.fit.fit',"
        " 'glsplat.tracking.solvers', 'glsplat.authoring.reconstruct.photos'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout.split() == ["glsplat.authoring.reconstruct.photos"]

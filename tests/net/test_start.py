"""What a server's two processes load: nothing that they do not need, so that they are ready soon and stay small."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ABSENT = {"cv2", "trimesh", "scipy", "PIL", "glfw", "cryptography", "segno"}


def loaded_by(script: str) -> set[str]:
    """Top-level modules once a program has run."""
    end = "import sys; print('LOADED', *sorted({name.split('.')[0] for name in sys.modules}))"
    run = subprocess.run([sys.executable, "-c", script + "\n" + end], cwd=ROOT, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    return set(next(line for line in run.stdout.splitlines() if line.startswith("LOADED")).split()[1:])


@pytest.mark.check
def test_the_serving_process():
    """The command and its options, the scene, tracking, a picture encoded whole and cropped, alpha too."""
    loaded = loaded_by("""
import json
import numpy as np
from apps.serve import command as serve
from apps.args import open_scene
from glsplat.net.served_scene import gl_server
from glsplat.net.codec.encode import Encoder
from glsplat.net.messages import Decoder

from apps.serve.options import ServeOptions
args = ServeOptions()
server = gl_server(open_scene(args), serve.server_config(args))
head = {"head": [0, 1.5, 0, 0, 0, 0, 1]}
request = Decoder().decode(json.dumps({"v": 1, "frame_id": 1, "t": 0.0, "tracking": head}))
server.catalogue["default"].solver(1.7, None).solve(request, 0.0)
images = np.zeros((2, 64, 256, 4), np.uint8)
images[:, 20:40, 100:120] = 200
encoder = Encoder()
for crop in (False, True):
    encoder.encode(images, 80, crop, (100, 20, 20, 20), True)
encoder.close()
""")
    assert not loaded & ABSENT
    assert "moderngl" not in loaded and {"aiohttp", "simplejpeg", "numpy"} <= loaded


@pytest.mark.gl
def test_the_drawing_process():
    """What `process_worker` starts: unpickled, opened, a picture drawn. No network either."""
    loaded = loaded_by("""
import pickle
from functools import partial
from glsplat.data import default_avatar
from glsplat.net.worker import work
from glsplat.net.backends.gl import RendererBackend
from glsplat.net.backend import RenderJob
from glsplat.net.messages import Decoder

backend = pickle.loads(pickle.dumps(partial(RendererBackend, default_avatar(), (64, 64))))()
backend.open()
eye = {"viewmat": [1, 0, 0, 0, 0, -1, 0, 1.2, 0, 0, -1, 2, 0, 0, 0, 1], "K": [50, 50, 32, 32]}
message = {"v": 1, "frame_id": 1, "eyes": [eye], "size": [64, 64]}
import json
job = RenderJob(cameras=Decoder().decode(json.dumps(message)).cameras)
assert backend.render(job).images.any()
backend.close()
""")
    assert not loaded & (ABSENT | {"aiohttp", "simplejpeg"})
    assert "moderngl" in loaded

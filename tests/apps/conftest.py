"""A server of numpy pictures that runs in a thread of its own, for commands that bring their own event loop."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest

from glsplat.net.backend import AvatarInfo, Rendered
from tests.browser.served import Served


class Stripes:
    delay = 0.0

    def __init__(self) -> None:
        self.requests = []

    def open(self) -> str:
        return "numpy"

    def render(self, request) -> Rendered:
        self.requests.append(request)
        time.sleep(self.delay)
        camera = request.cameras[0]
        out = np.zeros((len(request.cameras), camera.height, camera.width, 4), np.uint8)
        out[:, :, 16:48] = (200, (request.frame_id * 9) % 256, 40, 255)
        return Rendered(out, {"skin": 0.1, "draw": 0.2, "total": 0.3})

    def close(self) -> None:
        pass


@pytest.fixture
def stripes() -> Iterator[tuple[str, Stripes]]:
    """(url, backend) of a running server."""
    backend = Stripes()
    with running(backend) as url:
        yield url, backend


@contextmanager
def running(backend: Stripes, **offered: str) -> Iterator[str]:
    """The url of a server of it, which offers one avatar with these settings."""
    with Served(backend, offered=[AvatarInfo(name="default", **offered)]) as served:
        yield served.server.url


@pytest.fixture(autouse=True)
def _no_log_of_commands() -> Iterator[None]:
    """A command that logs in the tests' own process writes to the standard error that it had."""
    root = logging.getLogger()
    level = root.level
    yield
    root.setLevel(level)
    for handler in [one for one in root.handlers if type(one) is logging.StreamHandler]:
        root.removeHandler(handler)
    logging.captureWarnings(False)


@pytest.fixture
def quickly_made(monkeypatch: pytest.MonkeyPatch) -> None:
    """Avatars of meshes by few rays, and levels in few steps: what is tested is the command."""
    from apps.avatar import making
    from glsplat.extras.authoring.finish.levels import with_levels
    from glsplat.extras.authoring.light import surfaces
    from glsplat.extras.authoring.sample.surface import SamplerConfig, make_avatar

    def made(mesh, splats, seed, **more):
        return make_avatar(mesh, splats, seed, SamplerConfig(probe=96), **more)

    monkeypatch.setattr(making, "make_avatar", made)
    monkeypatch.setattr(making, "with_levels", partial(with_levels, steps=6))
    monkeypatch.setattr(surfaces, "ambient_occlusion", partial(surfaces.ambient_occlusion, directions=6))


@pytest.fixture
def front(tmp_path: Path) -> Path:
    """A small grey picture, for reconstructors that need no work."""
    path = tmp_path / "in" / "front.jpg"
    path.parent.mkdir()
    cv2.imwrite(str(path), np.full((90, 60, 3), 77, np.uint8))
    return path

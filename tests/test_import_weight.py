"""What an import brings along, in a process of its own: only the libraries and the modules that the task needs."""

from __future__ import annotations

import subprocess
import sys

import pytest

import glsplat.formats
import glsplat.net
import glsplat.tracking

LIBRARIES = (
    *("PIL", "aiohttp", "cryptography", "cv2", "glfw", "matplotlib", "moderngl", "numba", "scipy", "segno"),
    *("simplejpeg", "trimesh"),
)
ANY = 1000  # modules of glsplat: not bounded

ROWS = [  # statement, libraries, modules of glsplat at most
    ("import glsplat", "", 1),
    ("import glsplat.tracking.sample", "", 6),  # the names of expressions among them
    ("import glsplat.net.messages", "", 20),
    ("from glsplat import Avatar, Splats", "", 16),  # their pictures in notebooks import the renderer when shown
    ("from glsplat import default_avatar; default_avatar()", "", ANY),
    ("from glsplat import Renderer", "moderngl", ANY),
    ("from glsplat.net.client import Client", "aiohttp simplejpeg", 36),
    ("import apps.serve.command", "aiohttp simplejpeg", 120),  # extras only where an option asks for them
    ("import apps.render", "moderngl cv2", ANY),  # cv2 writes PNG and clips
]
EXTRAS = [
    ("import glsplat.tracking", "", 2),
    (
        "from glsplat.formats.motion_files import load_embedded_motion as load; load('walk', __import__('glsplat')"
        ".default_avatar().skeleton).resampled(11.0)",
        "",
        ANY,
    ),
    ("import glsplat.tracking.tracker", "", ANY),
    ("import glsplat.formats.scene_file", "", ANY),
    ("import glsplat.extras.authoring.geometry.posed", "", ANY),
    ("import glsplat.extras.authoring.finish.cones", "cv2 scipy", ANY),
    ("import glsplat.extras.authoring.reconstruct.photos", "PIL cv2 scipy simplejpeg", ANY),
    (
        "import glsplat.extras.authoring.reconstruct.builtin",
        "PIL cv2 scipy simplejpeg trimesh",
        ANY,
    ),  # no numba: it loads in a thread
    ("import apps.args, apps.convert, apps.inspect", "", ANY),
]


def loaded(statement: str) -> set[str]:
    """Return the names of all modules that are loaded after a statement."""
    done = subprocess.run(
        [sys.executable, "-c", f"{statement}\nimport sys; print(*sys.modules)"],
        check=True,
        capture_output=True,
        text=True,
    )
    return set(done.stdout.split())


@pytest.mark.parametrize(
    ("statement", "libraries", "most"),
    [*ROWS, *(pytest.param(*row, marks=pytest.mark.check) for row in EXTRAS)],
)
def test_an_import_loads_what_it_needs(statement: str, libraries: str, most: int) -> None:
    modules = loaded(statement)
    own = {name for name in modules if name.split(".")[0] == "glsplat"}
    assert set(LIBRARIES) & modules == set(libraries.split())
    assert len(own) <= most, sorted(own)


@pytest.mark.check
def test_a_photograph_is_checked_before_the_imports_that_make_an_avatar() -> None:
    modules = loaded("import apps.cli\napps.cli.parsed('avatar', ['photo', 'me.jpg', '-o', 'me.glb'])")
    assert not {"trimesh", "numba", "moderngl", "scipy.optimize"} & modules
    assert not {"glsplat.extras.authoring.fit.body_fit", "glsplat.tracking.solvers"} & modules


@pytest.mark.check
@pytest.mark.parametrize(
    "package", [glsplat, glsplat.formats, glsplat.net, glsplat.tracking], ids=lambda package: package.__name__
)
def test_a_lazy_package_has_all_that_it_lists(package: object) -> None:
    name, names = package.__name__, package.__all__  # type: ignore[attr-defined]
    assert dir(package) == sorted(names)
    loaded(f"from {name} import *\nimport {name}\nfor one in {name}.__all__: getattr({name}, one)")
    with pytest.raises(AttributeError, match="attribute nonsense"):
        package.nonsense  # type: ignore[attr-defined]  # noqa: B018

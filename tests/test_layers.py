"""Imports go down and never in a circle, every package is installed, and the root exports what it says."""

from __future__ import annotations

import ast
import importlib.util
import subprocess
import sys
import tomllib
from collections.abc import Iterable
from functools import cache
from pathlib import Path

import pytest

import glsplat

ROOT = Path(__file__).resolve().parents[1]

# Lower floors first. A room is a folder or a module right in glsplat/, and nothing smaller: no file is lifted out of
# its folder. A module imports from floors below its own, or from its own room. What stands beside a room on one floor
# is not seen from it.
FLOORS = [
    ["errors", "timing", "rotations"],
    ["arrays", "io", "statistics"],
    ["light"],
    ["splats", "camera", "config", "pictures", "models", "watermark"],
    ["skinning", "shaders"],
    ["avatar", "meshes", "gl", "speech"],
    ["scene", "reference", "detail"],
    ["formats", "views"],
    ["motion", "data", "consent"],
    ["scenes", "tracking"],
    ["passes"],
    ["renderer_thread", "mesh"],
    ["renderer"],
    ["authoring", "net"],
    ["evaluate", "study", "xr"],
    ["apps"],
]
# Within a room its modules may have an order, what is not named last. This allows nothing: it forbids more.
WITHIN = {
    "formats": [
        ["gltf.schema", "gltf.meshopt"],
        ["gltf.container"],
        ["gltf.nodes"],
        ["gltf.bound", "gltf.vrm", "gltf.animation"],
    ],
    "passes": [
        ["stats", "views", "block", "lru_cache"],
        ["item", "step"],
        ["arena", "target"],
        ["frame", "target_pool", "present"],
    ],
    "tracking": [["solve"]],
    "net": [["codec"]],
}
FLOOR = {room: level for level, rooms in enumerate(FLOORS) for room in rooms}
ROOT_INIT = "glsplat"  # imports names from everywhere, on demand
ROOT_OWN = {"on_demand", "__version__"}  # what the root itself defines, below everything

# what a room never imports, whatever its floor
FORBIDDEN = {
    "glsplat.net": {"moderngl", "glfw"},
    "glsplat.tracking": {"moderngl", "glfw", "cv2"},
    "glsplat.formats": {"moderngl"},
    "glsplat": {"glfw", "apps", "glsplat_apps", "tests"},
    "apps": {"tests"},
}
# the float64 twin is slow on purpose: it measures, and it makes avatars offline, but draws nothing
ORACLE = ("glsplat.reference", ("glsplat.reference", "glsplat.evaluate", "glsplat.authoring", "tests"))


def name_of(path: Path) -> str:
    parts = list(path.relative_to(ROOT).with_suffix("").parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


FILES = {name_of(p): p for folder in ("glsplat", "apps") for p in sorted((ROOT / folder).rglob("*.py"))}


def imports_of(module: str) -> frozenset[str]:
    """Every module that this one imports, also inside functions; of the project's own by the file's name."""
    return _imports(module, FILES[module])


@cache
def _imports(module: str, path: Path) -> frozenset[str]:
    package = module.split(".") if path.name == "__init__.py" else module.split(".")[:-1]
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {own(alias.name) for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            start = ".".join([*base, *([node.module] if node.module else [])])
            for alias in node.names:  # `from room import module` imports the module, else the name's home
                if start == ROOT_INIT and alias.name in ROOT_OWN:
                    continue
                inner = own(f"{start}.{alias.name}")
                if start == ROOT_INIT and alias.name in glsplat._HOME:
                    inner = f"{ROOT_INIT}.{glsplat._HOME[alias.name]}"
                found.add(inner if inner in FILES else own(start))
    return frozenset(found - {module})


def own(name: str) -> str:
    return "apps" + name.removeprefix("glsplat_apps") if name.split(".")[0] == "glsplat_apps" else name


def room_of(module: str) -> str:
    package, _, inner = module.partition(".")
    return inner.partition(".")[0] if package == ROOT_INIT else package


def place_of(module: str) -> tuple[int, int, str]:
    """Its floor, that within its room, and what stands together there."""
    room = room_of(module)
    own_floors = WITHIN.get(room, [])
    ranks = {f"{ROOT_INIT}.{room}.{name}": level for level, names in enumerate(own_floors) for name in names}
    part = next((name for name in ranks if f"{module}.".startswith(f"{name}.")), room)
    return FLOOR[room], ranks.get(part, len(own_floors)), part


def offences(modules: Iterable[str]) -> list[str]:
    """Every import that breaks a rule, a line each."""
    out = []
    for module in modules:
        floor, level, part = place_of(module)
        for name in sorted(imports_of(module)):
            if any(f"{module}.".startswith(f"{room}.") and name.split(".")[0] in no for room, no in FORBIDDEN.items()):
                out.append(f"{module} imports {name}")
            if name == ROOT_INIT and module.startswith(f"{ROOT_INIT}."):
                out.append(f"{module} imports the root")
            if name == ROOT_INIT or name not in FILES:
                continue
            other_floor, other_level, other_part = place_of(name)
            if other_floor > floor or (other_floor == floor and room_of(name) != room_of(module)):
                out.append(f"{module} imports up: {name}")
            elif room_of(name) == room_of(module) and other_part != part and other_level >= level:
                out.append(f"{module} imports up within its room: {name}")
            if name == ORACLE[0] and not module.startswith(ORACLE[1]):
                out.append(f"{module} imports the oracle")
    return out


def test_rooms_are_folders_and_nothing_smaller() -> None:
    rooms = {room_of(module) for module in FILES if module != ROOT_INIT}
    assert set(FLOOR) == rooms and sum(map(len, FLOORS)) == len(rooms)
    lost = [
        f"{room}.{name}"
        for room, own_floors in WITHIN.items()
        for names in own_floors
        for name in names
        if f"{ROOT_INIT}.{room}.{name}" not in FILES
    ]
    assert not lost


def test_imports_go_down() -> None:
    assert not offences(name for name in FILES if name != ROOT_INIT)


def test_no_circle() -> None:
    """Depth first over the whole tree, packages and function-level imports included."""
    done: set[str] = set()

    def walk(module: str, trail: tuple[str, ...]) -> None:
        assert module not in trail, " > ".join((*trail[trail.index(module) :], module))
        if module in done or module == ROOT_INIT:
            return
        for name in sorted(imports_of(module)):
            if name in FILES:
                walk(name, (*trail, module))
        done.add(module)

    for module in FILES:
        walk(module, ())
    assert len(done) > 200


PLANTED = [
    ("glsplat.camera", "from glsplat import Renderer"),  # from the root, which knows all
    ("glsplat.camera", "from glsplat import Scene as S, Splats"),
    ("glsplat.camera", "import glsplat"),
    ("glsplat.camera", "import glsplat.renderer as r"),
    ("glsplat.camera", "from . import renderer"),
    ("glsplat.skinning.skin", "from ..passes.frame import key"),
    ("glsplat.skinning.skin", "def f():\n    from glsplat.formats.gltf.splats import load_gltf"),  # in a function
    ("glsplat.net.session", "class A:\n    def f(self):\n        import moderngl"),
    ("glsplat.net.session", "if False:\n    from glsplat.evaluate.machine import machine"),
    ("glsplat.tracking.sample", "import cv2.aruco"),
    ("glsplat.passes.arena", "from glsplat import reference"),
    ("glsplat.passes.item.buffers", "from glsplat.passes.arena import Arena"),  # up within a room
    ("glsplat.formats.format", "import glsplat.consent.document"),  # rooms that were a circle once
    ("glsplat.formats.format", "from glsplat.motion.motion import Motion"),
    ("glsplat.evaluate.frames", "from apps.output import label"),
    ("glsplat.evaluate.frames", "from glsplat_apps.output import label"),
    ("glsplat.evaluate.frames", "from tests.scenes import cloud"),
    ("apps.output", "from tests.scenes import cloud"),
    ("apps.report.plots", "from glsplat.reference import skin"),
]


@pytest.mark.parametrize(("module", "line"), PLANTED)
def test_a_planted_import_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: str, line: str) -> None:
    assert not offences([module])
    plant(tmp_path, monkeypatch, {module: line})
    assert [said for said in offences([module]) if said.startswith(f"{module} imports")]


@pytest.mark.parametrize(
    "lines",
    [
        {"apps.tracking.options": "from .command import run"},
        {"apps.output": "def f():\n    from . import render"},
        {"glsplat.net.session": "from glsplat.net import server"},
    ],
)
def test_a_planted_circle_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lines: dict[str, str]) -> None:
    plant(tmp_path, monkeypatch, lines)
    with pytest.raises(AssertionError, match=" > "):
        test_no_circle()


def plant(folder: Path, monkeypatch: pytest.MonkeyPatch, lines: dict[str, str]) -> None:
    """Lines at the end of copies of modules, which stand for the modules until the test is over."""
    for module, line in lines.items():
        copy = folder / module / FILES[module].name
        copy.parent.mkdir()
        copy.write_text(f"{FILES[module].read_text()}\n{line}\n")
        monkeypatch.setitem(FILES, module, copy)


def test_the_rules_can_fail() -> None:
    assert "glsplat.net.messages" in imports_of("glsplat.net.session")
    assert "apps.args" in imports_of("apps.render") and "glsplat.renderer" in imports_of("apps.render")
    assert room_of("glsplat.passes.frame.key") == "passes" and room_of("apps.report.html") == "apps"
    assert place_of("glsplat.passes.frame.key")[2] == "glsplat.passes.frame"
    assert place_of("glsplat.passes.item.buffers")[1] < place_of("glsplat.passes.frame.key")[1]
    assert "glsplat.shaders" in imports_of("glsplat.passes.frame.key")  # names of a package, not only modules


def test_every_package_is_installed() -> None:
    setup = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    folders = {name for name, path in FILES.items() if path.name == "__init__.py"}
    assert set(setup["packages"]) == {name.replace("apps", "glsplat_apps", 1) for name in folders}


def test_public_names() -> None:
    assert len(glsplat.__all__) <= 22
    for name in glsplat.__all__:
        assert getattr(glsplat, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        glsplat.nonsense  # noqa: B018


@pytest.mark.parametrize("module", ["glsplat.tracking", "glsplat.net.messages", "glsplat.net.client.client"])
def test_tracking_and_protocol_work_without_opengl(module: str) -> None:
    assert importlib.util.find_spec(module)
    script = f"import sys, {module}; assert not {{'moderngl', 'cv2', 'trimesh'}} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", script], check=True)

"""Imports go down and never in a circle, extras import what they require, every package is installed."""

from __future__ import annotations

import ast
import posixpath
import re
import tomllib
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

from glsplat.net.pages import STATIC_IMPORT, page_folders, read_folder
from tools.without_extra import requirements

ROOT = Path(__file__).resolve().parents[1]

# Lower floors first. A room is a folder or a module right in glsplat/, or a folder of extras. A module of the core
# imports from floors below its own, or from its own room; rooms on one floor do not see each other.
FLOORS = [
    ["errors", "timing", "rotations"],
    ["arrays", "io", "optional"],
    ["light", "camera", "config", "pictures"],
    ["splats", "shaders", "skinning"],
    ["avatar", "gl", "meshes", "motion", "reference", "tracking"],
    ["scene"],
    ["formats", "views"],
    ["data", "renderer"],
    ["net"],
    ["extras"],
    ["apps"],
]
# Within a package its modules and packages may have an order of their own; those that are not named come last.
WITHIN = {
    "renderer": [
        ["checks", "frame_block", "levels", "owned", "stats"],
        ["bounds", "project", "sort"],
        ["stage"],
        ["gpu_sort", "skin", "targets"],
        ["arena", "draw", "mesh_pass", "present", "read_back", "resolve"],
        ["key"],
        ["pipeline"],
        ["gpu_scene"],
        ["renderer"],
        ["thumbnail"],
    ],
    "tracking": [["solve"]],
    "net": [
        ["codec", "pace", "room_view", "wire_schema"],
        ["rights"],
        ["guard"],
        ["messages"],
        ["backend", "reply", "session"],
        ["worker"],
        ["backends", "catalogue", "flow", "options", "pose_queue"],
        ["client", "client_stream"],
        ["drawer"],
        ["internal_client", "render_loop"],
        ["feature"],
        ["pages"],
        ["conversation"],
        ["server"],
        ["served_scene"],
    ],
    # tools, then the steps in which a photograph becomes an avatar, then what calls the steps
    "extras.authoring": [
        ["compute", "mesh_truth", "models"],
        ["geometry", "networks"],
        ["body", "photo"],
        ["segment"],
        ["check"],
        ["fit"],
        ["dress"],
        ["paint"],
        ["sample"],
        ["templates"],
        ["optimize"],
        ["faces", "light"],
        ["finish"],
        ["importers", "video"],
        ["reconstruct"],
    ],
}
FLOOR = {room: level for level, rooms in enumerate(FLOORS) for room in rooms}
ROOT_OWN = {"on_demand", "__version__"}  # defined by the root itself, below everything

# what a room never imports, whatever its floor
FORBIDDEN = {
    "glsplat.net": {"moderngl", "glfw"},
    "glsplat.tracking": {"moderngl", "glfw", "cv2"},
    "glsplat.formats": {"moderngl"},
    "glsplat": {"glfw", "apps", "glsplat_apps", "tests"},
    "apps": {"tests"},
}
# the float64 twin is slow on purpose: it measures, and makes avatars offline, but draws nothing
ORACLE = ("glsplat.reference", ("glsplat.reference", "glsplat.extras.evaluate", "glsplat.extras.authoring", "tests"))


def name_of(path: Path) -> str:
    parts = list(path.relative_to(ROOT).with_suffix("").parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


# where the root's names are defined, by its stub
HOMES = {
    alias.name: f"glsplat.{node.module}"
    for node in ast.parse((ROOT / "glsplat" / "__init__.pyi").read_text()).body
    if isinstance(node, ast.ImportFrom)
    for alias in node.names
}
FILES = {name_of(p): p for folder in ("glsplat", "apps") for p in sorted((ROOT / folder).rglob("*.py"))}


@cache
def imports_of(module: str) -> frozenset[str]:
    """Return every module that this one imports, also inside functions; of the project's own by the file's name."""
    return imports_in(FILES[module].read_text(encoding="utf-8"), module)


def imports_in(text: str, module: str) -> frozenset[str]:
    package = module.split(".") if FILES[module].name == "__init__.py" else module.split(".")[:-1]
    found = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            found |= {own(alias.name) for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            start = ".".join([*base, *([node.module] if node.module else [])])
            for alias in node.names:  # `from room import module` imports the module, else the name's home
                if start == "glsplat" and alias.name in ROOT_OWN:
                    continue
                inner = own(f"{start}.{alias.name}")
                if start == "glsplat":
                    inner = HOMES.get(alias.name, inner)
                found.add(inner if inner in FILES else own(start))
    return frozenset(found - {module})


def own(name: str) -> str:
    return "apps" + name.removeprefix("glsplat_apps") if name.split(".")[0] == "glsplat_apps" else name


def room_of(module: str) -> str:
    package, _, inner = module.partition(".")
    return inner.partition(".")[0] if package == "glsplat" else package


def level_of(module: str, package: str) -> tuple[int, str]:
    """Return a module's level within a package of WITHIN, and what stands together there."""
    levels = WITHIN[package]
    part = module.removeprefix(f"glsplat.{package}.").partition(".")[0]
    level = next((level for level, names in enumerate(levels) if part in names), len(levels))
    return level, part if level < len(levels) else ""


def offences(module: str, imports: frozenset[str]) -> list[str]:
    """Return every import that breaks a rule."""
    out = []
    room = room_of(module)
    ordered = [package for package in WITHIN if f"{module}.".startswith(f"glsplat.{package}.")]
    for name in sorted(imports):
        if any(f"{module}.".startswith(f"{place}.") and name.split(".")[0] in no for place, no in FORBIDDEN.items()):
            out.append(f"{module} imports {name}")
        if name == "glsplat" and module.startswith("glsplat."):
            out.append(f"{module} imports the root")
        if name == "glsplat" or name not in FILES:
            continue
        if room_of(name) != room and FLOOR[room_of(name)] >= FLOOR[room]:
            out.append(f"{module} imports up: {name}")
        for package in ordered:
            if f"{name}.".startswith(f"glsplat.{package}."):
                (level, part), (other_level, other_part) = level_of(module, package), level_of(name, package)
                if other_part != part and other_level >= level:
                    out.append(f"{module} imports up within {package}: {name}")
        if name == ORACLE[0] and not module.startswith(ORACLE[1]):
            out.append(f"{module} imports the oracle")
    return out


def test_imports_go_down() -> None:
    assert set(FLOOR) == {room_of(module) for module in FILES if module != "glsplat"}
    for package in ("net", "extras.authoring"):
        prefix = f"glsplat.{package}."
        inside = {module.removeprefix(prefix).partition(".")[0] for module in FILES if module.startswith(prefix)}
        if inside or package == "net":  # an extra may be deleted
            assert inside == {name for names in WITHIN[package] for name in names}
    assert not [line for name in FILES if name != "glsplat" for line in offences(name, imports_of(name))]


@pytest.mark.parametrize(
    ("module", "line"),
    [
        ("glsplat.camera", "from glsplat import Renderer"),  # from the root, which has all names
        ("glsplat.skinning.skin", "def f():\n    from ..renderer import key"),
        ("glsplat.net.session", "import moderngl"),
        ("glsplat.renderer.arena", "from glsplat import reference"),
        ("glsplat.renderer.stage", "from glsplat.renderer.arena import Arena"),  # up within a room
        ("glsplat.net.session", "from glsplat.net.client_stream import ClientStream"),
        pytest.param(  # a later step
            "glsplat.extras.authoring.fit.view",
            "from glsplat.extras.authoring.paint.lamp import Lamp",
            marks=pytest.mark.extra(name="authoring"),
        ),
        pytest.param(  # a step of the same level
            "glsplat.extras.authoring.light.surfaces",
            "from glsplat.extras.authoring.faces import lids",
            marks=pytest.mark.extra(name="authoring"),
        ),
        ("glsplat.net.session", "from glsplat.extras import uploads"),  # the core, an extra
        ("glsplat.extras", "from glsplat_apps.output import label"),
    ],
)
def test_an_import_upwards_is_found(module: str, line: str) -> None:
    assert offences(module, imports_in(line, module))


def test_no_circle() -> None:
    done: set[str] = set()

    def walk(module: str, trail: tuple[str, ...]) -> None:
        assert module not in trail, " > ".join((*trail[trail.index(module) :], module))
        if module in done or module == "glsplat":
            return
        for name in imports_of(module) & FILES.keys():
            walk(name, (*trail, module))
        done.add(module)

    for module in FILES:
        walk(module, ())


def test_extras_import_the_extras_that_they_require_and_no_others() -> None:
    required, imported = requirements(ROOT), {name: set() for name in requirements(ROOT)}
    for module in FILES:
        for other in imports_of(module):
            if module.startswith("glsplat.extras.") and other.startswith("glsplat.extras."):
                imported[module.split(".")[2]].add(other.split(".")[2])
    assert required == {name: tuple(sorted(others - {name})) for name, others in imported.items()}
    TopologicalSorter(required).prepare()  # raises CycleError for a circle


def test_every_package_is_installed() -> None:
    setup = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    folders = {name for name, path in FILES.items() if path.name == "__init__.py"}
    assert set(setup["packages"]) == {name.replace("apps", "glsplat_apps", 1) for name in folders}


PAGE = {room: dict(read_folder(folder)) for room, folder in page_folders().items()}  # "" is the core
REFERENCE = re.compile(rb"""(?:import\(|new URL\()['"](\.[^'"]+\.js)['"]|(?:src|href)="([^"]+\.(?:js|css|svg))\"""")


def referred(path: str, names: list[bytes]) -> set[str]:
    return {posixpath.normpath(posixpath.join(posixpath.dirname(path), name.decode())) for name in names}


def test_no_two_folders_of_the_page_have_a_file_of_one_path() -> None:
    paths = [path for files in PAGE.values() for path in files]
    assert len(paths) == len({*paths}) and "main.js" in PAGE[""]


@pytest.mark.parametrize("room", PAGE)
def test_modules_of_the_page_import_from_the_core_and_from_required_extras(room: str) -> None:
    """A module of the core imports none of an extra's but by import(), where the server offers what it is for."""
    below = {path for name in ("", room, *requirements(ROOT).get(room, ())) for path in PAGE.get(name, ())}
    modules = [path for path in PAGE[room] if path.endswith(".js")]
    imported = {path: referred(path, STATIC_IMPORT.findall(PAGE[room][path])) for path in modules}
    assert any(imported.values()) or len(modules) == 1
    assert not {path: names - below for path, names in imported.items() if names - below}


@pytest.mark.extra(name="browser")
@pytest.mark.extra(name="far_links")
@pytest.mark.extra(name="speech")
@pytest.mark.extra(name="uploads")
@pytest.mark.extra(name="voice")
def test_what_the_page_refers_to_is_there() -> None:
    files = {path: body for own in PAGE.values() for path, body in own.items()}
    named = {path: [b or c for b, c in REFERENCE.findall(body)] for path, body in files.items() if "iwer" not in path}
    assert {"stream/datagrams.js", "show/here.js"} <= referred("main.js", named["main.js"]) | referred(
        "stream/socket.js", named["stream/socket.js"]
    )
    found = {
        path: referred("index.html" if path == "photo/form.html" else path, names) for path, names in named.items()
    }
    assert not {path: names - files.keys() for path, names in found.items() if names - files.keys()}

"""Animations of humanoid rigs in glTF 2.0, and VRM animations (.vrma)."""

from __future__ import annotations

import numpy as np

from glsplat.arrays import F64
from glsplat.errors import FormatError, PoseError
from glsplat.extras.motions.animation import Animation, Tracks, animations_of, names_of, tracks_of
from glsplat.extras.motions.clip import Clip, check_size
from glsplat.extras.rigs.bound import bound_of, names_of_joints
from glsplat.extras.rigs.vrm import human_bones
from glsplat.formats.format import Opened
from glsplat.formats.gltf.container import Container, item, read_container
from glsplat.formats.gltf.nodes import Graph, graph_of, instances
from glsplat.rotations import nearest_rotations

_FPS, _SLOWEST, _FASTEST = 30.0, 15.0, 120.0  # default frame rate; range of key rates used instead
_MOST_NODES = 1 << 12
_BLOCK = 1 << 16  # joints times frames at a time


def read_animation(start: Opened, choice: str | None = None) -> Clip:
    """Read one animation of a .glb, .gltf, .vrm or .vrma; ``choice`` is its name or number, None the first.

    Its frame rate is that of its keys, at most 120 a second, or 30 a second if they have less than 15. The rest pose is
    that in which the skin was bound; without a skin, that of the nodes. Raises FormatError or PoseError.
    """
    container = read_container(start.file, start.size, start.folder)
    animations = animations_of(container)
    if not animations:
        raise PoseError("a motion in glTF is an animation, and this file has none")
    graph = graph_of(container.gltf)
    with np.errstate(all="ignore"):  # a matrix that overflows is refused below
        try:
            return _clip(container, graph, animations, choice)
        except np.linalg.LinAlgError:
            raise FormatError("a joint of the animation has no size") from None


def _chosen(animations: list[Animation], choice: str | None) -> int:
    names = names_of(animations)
    if choice is None:
        return 0
    if choice in names:
        return names.index(choice)
    if choice.isascii() and choice.isdigit() and len(choice) < 9 and int(choice) < len(animations):
        return int(choice)
    last = [name for name in names if name.rsplit("|", 1)[-1].lower() == choice.lower()]
    if len(last) == 1:  # "Armature|Walk" of Blender
        return names.index(last[0])
    raise PoseError(f"no animation {choice[:40]!r}; there are {_listed(names)}")


def _listed(names: list[str]) -> str:
    shown = ", ".join(name[:30] for name in names[:20])
    return f"{shown}, and {len(names) - 20} more" if len(names) > 20 else shown


def _clip(container: Container, graph: Graph, animations: list[Animation], choice: str | None) -> Clip:
    number = _chosen(animations, choice)
    skins = _skins(container, graph)
    bones = human_bones(container.gltf)
    names = names_of_joints(container, skins, dict(bones))
    joints = [node for node, name in enumerate(names) if name or node in bones.values()]
    if len(joints) > _MOST_NODES:
        raise PoseError(f"a rig has at most {_MOST_NODES} joints here, not {len(joints)}")
    tracks = tracks_of(container, graph, animations[number], joints)
    if len(tracks.nodes) > _MOST_NODES:
        raise PoseError(f"a rig has at most {_MOST_NODES} nodes here, not {len(tracks.nodes)}")
    fps = min(tracks.rate, _FASTEST) if tracks.rate >= _SLOWEST else _FPS
    seconds = tracks.end - tracks.start
    if not seconds * fps < 1e9:
        raise PoseError(f"an animation of {seconds:g} s is too long; cut it")
    frames = round(seconds * fps) + 1
    check_size(frames, len(tracks.nodes))

    bound = bound_of(container, graph, skins)
    rest = bound.shown @ bound.frames[tracks.nodes]
    turns, places = _moved(tracks, rest, frames, fps)
    index = {node: k for k, node in enumerate(tracks.nodes)}
    parents = np.array([index.get(int(graph.parents[node]), -1) for node in tracks.nodes], np.int32)
    given: dict[str, int | None] = {name: index[node] for name, node in bones.items()}
    label, note = "", ""
    if len(animations) > 1:
        called = names_of(animations)
        label = f"#{called[number]}"
        if choice is None:
            note = (
                f"{called[0][:40]}, the first of {len(called)} animations; #NAME chooses another: {_listed(called[1:])}"
            )
    called_so = tuple(names[node] for node in tracks.nodes)
    return Clip(called_so, parents, rest[:, :3, 3], turns, places, fps, given=given, y_up=True, label=label, note=note)


def _skins(container: Container, graph: Graph) -> list[int]:
    """Return the used skins, the one with the most joints first."""
    gltf = container.gltf
    used = {instance.node.skin for instance in instances(gltf, graph.world)} - {None}
    skins = [skin for skin in used if skin is not None]
    return sorted(skins, key=lambda skin: (-len(item(gltf.skins, skin, "skin").joints), skin))


def _moved(tracks: Tracks, rest: F64, frames: int, fps: float) -> tuple[F64, F64]:
    """Return the nodes' rotations [T, N, 3, 3] from the rest pose and positions [T, N, 3]; both in the world."""
    count = len(tracks.nodes)
    bases = rest[:, :3, :3].copy()
    bases[np.linalg.svd(bases, compute_uv=False)[:, -1] <= 0] = np.eye(3)  # hidden by a scale of 0: of no person
    back = np.linalg.inv(bases)
    turns, places = np.empty((frames, count, 3, 3)), np.empty((frames, count, 3))
    step = max(1, _BLOCK // max(count, 1))
    for first in range(0, frames, step):
        part = slice(first, min(first + step, frames))
        worlds = tracks.worlds(tracks.start + np.arange(part.start, part.stop) / fps)
        linear = worlds[:, :, :3, :3] @ back
        linear[~np.isfinite(linear).all(axis=(2, 3))] = np.nan
        good = np.isfinite(linear).all(axis=(2, 3))
        turned = np.full_like(linear, np.nan)
        turned[good] = nearest_rotations(linear[good])
        turns[part], places[part] = turned, worlds[:, :, :3, 3]
    return turns, places

"""Animations of humanoid rigs in glTF 2.0 (3.11 and appendix C), and VRM animations (.vrma)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import msgspec
import numpy as np

from glsplat.arrays import F64
from glsplat.errors import FormatError, PoseError
from glsplat.extras.motions.clip import Clip, check_size
from glsplat.extras.rigs.gltf import bound_of, human_bones, names_of_joints
from glsplat.formats.format import Opened
from glsplat.formats.gltf.container import Container, item, read_container
from glsplat.formats.gltf.nodes import Graph, graph_of, instances
from glsplat.formats.gltf.schema import Index
from glsplat.rotations import nearest_rotations, quaternion_matrices, unit_vectors

_PATHS = {"translation": ("VEC3",), "rotation": ("VEC4",), "scale": ("VEC3",)}
_KINDS = ("LINEAR", "STEP", "CUBICSPLINE")
_MOST_KEYS = 1 << 22  # of all tracks together: many may share an accessor

_FPS, _SLOWEST, _FASTEST = 30.0, 15.0, 120.0  # default frame rate; range of key rates used instead
_MOST_NODES = 1 << 12
_BLOCK = 1 << 16  # joints times frames at a time


class _Target(msgspec.Struct):
    path: str = ""
    node: Index | None = None


class _Channel(msgspec.Struct):
    sampler: Index
    target: _Target


class _Sampler(msgspec.Struct):
    input: Index
    output: Index
    interpolation: str = "LINEAR"


class Animation(msgspec.Struct):
    """An entry of animations[]."""

    channels: list[_Channel]
    samplers: list[_Sampler]
    name: str | None = None


@dataclass(frozen=True, eq=False)
class _Track:
    times: F64  # [K] seconds, rising
    values: F64  # [K, C], or [K, 3, C] in-tangent, value, out-tangent of a CUBICSPLINE
    kind: str

    def at(self, times: F64, turn: bool) -> F64:
        """Return values [T, C] at ``times`` [T], constant beyond the first and last keys. ``turn``: quaternions."""
        cubic = self.kind == "CUBICSPLINE"
        values = self.values[:, 1] if cubic else self.values
        if len(values) == 1:
            return np.repeat(values, len(times), axis=0)
        last = len(self.times) - 1
        first = np.clip(np.searchsorted(self.times, times, "right") - 1, 0, last)
        if self.kind == "STEP":
            return np.asarray(values[first])
        first = np.minimum(first, last - 1)
        step = self.times[first + 1] - self.times[first]
        part = np.clip((times - self.times[first]) / np.maximum(step, 1e-12), 0, 1)
        a, b, t = values[first], values[first + 1], part[:, None]
        if cubic:
            out, into = self.values[first, 2] * step[:, None], self.values[first + 1, 0] * step[:, None]
            a, b = a * (1 + 2 * t) * (1 - t) ** 2, b * t**2 * (3 - 2 * t)
            return np.asarray(a + out * t * (1 - t) ** 2 + b + into * t**2 * (t - 1))
        return _slerp(a, b, part) if turn else np.asarray(a + (b - a) * t)


@dataclass(frozen=True, eq=False)
class Tracks:
    """An animation of some nodes and their ancestors."""

    graph: Graph
    nodes: list[int]  # parents come first
    start: float  # time of the first key, seconds
    end: float  # time of the last key, seconds
    rate: float  # keys a second of the track with the most keys; 0 if none has two
    _moved: dict[tuple[int, str], _Track]
    _rest: dict[tuple[int, str], F64]

    def worlds(self, times: F64) -> F64:
        """Return global matrices [T, N, 4, 4] of ``nodes`` at ``times`` [T]."""
        out = np.empty((len(times), len(self.nodes), 4, 4))
        place = {node: k for k, node in enumerate(self.nodes)}
        with np.errstate(all="ignore"):  # callers check for values that are not finite
            for k, node in enumerate(self.nodes):
                out[:, k] = self._local(node, times)
                above = place.get(int(self.graph.parents[node]))
                if above is not None:
                    out[:, k] = out[:, above] @ out[:, k]
        return out

    def _local(self, node: int, times: F64) -> F64:
        if (node, "matrix") in self._rest:
            return np.broadcast_to(self._rest[node, "matrix"], (len(times), 4, 4))
        values = {
            path: self._moved[node, path].at(times, path == "rotation")
            if (node, path) in self._moved
            else np.broadcast_to(self._rest[node, path], (len(times), len(self._rest[node, path])))
            for path in _PATHS
        }
        turn = values["rotation"]
        sizes = np.linalg.norm(turn, axis=1, keepdims=True)
        turn = np.where(sizes > 0, turn / np.where(sizes > 0, sizes, 1), (0, 0, 0, 1))
        out = np.tile(np.eye(4), (len(times), 1, 1))
        out[:, :3, :3] = quaternion_matrices(turn[:, [3, 0, 1, 2]]) * values["scale"][:, None]
        out[:, :3, 3] = values["translation"]
        return out


def animations_of(container: Container) -> list[Animation]:
    """Return all animations of a file. Raises FormatError if one is malformed."""
    try:
        return msgspec.convert(container.gltf.animations, list[Animation])
    except msgspec.ValidationError as error:
        raise FormatError(f"an animation is malformed: {str(error)[:120]}") from None


def names_of(animations: Iterable[Animation]) -> list[str]:
    """Return the animations' names, or their numbers where they have none."""
    return [animation.name or str(place) for place, animation in enumerate(animations)]


def tracks_of(container: Container, graph: Graph, animation: Animation, nodes: Iterable[int]) -> Tracks:
    """Read only the tracks that move ``nodes`` and their ancestors. Raises FormatError for malformed tracks."""
    wanted: set[int] = set()
    for node in nodes:
        at = node
        while at >= 0 and at not in wanted:
            wanted.add(at)
            at = int(graph.parents[at])
    moved: dict[tuple[int, str], _Track] = {}
    keys = 0
    for channel in animation.channels:
        target, path = channel.target.node, channel.target.path
        if target is None or path not in _PATHS or target not in wanted or (target, path) in moved:
            continue  # an extension's path, morph weights, or another node
        sampler = item(animation.samplers, channel.sampler, "animation sampler")
        keys += item(container.gltf.accessors, sampler.output, "accessor of an animation").count
        if keys > _MOST_KEYS:
            raise FormatError(f"the animation has more than {_MOST_KEYS} keys; cut it")
        moved[target, path] = _track(container, sampler, path, f"the {path} of node {target}")
    times = [track.times for track in moved.values()]
    start, end = (float(min(t[0] for t in times)), float(max(t[-1] for t in times))) if times else (0.0, 0.0)
    most = max(times, key=len, default=np.zeros(1))
    steps = np.diff(most)
    rate = 1 / float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    rest: dict[tuple[int, str], F64] = {}
    for index in wanted:
        found = container.gltf.nodes[index]
        if found.matrix is not None:
            rest[index, "matrix"] = np.array(found.matrix).reshape(4, 4).T
            continue
        rest[index, "translation"] = np.array(found.translation or (0.0, 0.0, 0.0))
        rest[index, "rotation"] = np.array(found.rotation or (0.0, 0.0, 0.0, 1.0))
        rest[index, "scale"] = np.array(found.scale or (1.0, 1.0, 1.0))
    return Tracks(graph, [index for index in graph.order if index in wanted], start, end, rate, moved, rest)


def _track(container: Container, sampler: _Sampler, path: str, what: str) -> _Track:
    if sampler.interpolation not in _KINDS:
        raise FormatError(f"{what} is interpolated by {sampler.interpolation[:20]!r}, not by {', '.join(_KINDS)}")
    times = container.numbers(sampler.input, f"the times of {what}", ("SCALAR",))[:, 0].astype(np.float64)
    values = container.numbers(sampler.output, what, _PATHS[path]).astype(np.float64)
    if not len(times) or not np.isfinite(times).all() or (np.diff(times) < 0).any():
        raise FormatError(f"{what} needs finite times that rise, at least one")
    per_key = 3 if sampler.interpolation == "CUBICSPLINE" else 1
    if len(values) != per_key * len(times) or not np.isfinite(values).all():
        raise FormatError(
            f"{what} needs {per_key * len(times)} finite values for {len(times)} times, not {len(values)}"
        )
    return _Track(times, values.reshape(len(times), 3, -1) if per_key == 3 else values, sampler.interpolation)


def _slerp(first: F64, second: F64, part: F64) -> F64:
    """Interpolate between unit quaternions [T, 4] on the shorter arc (glTF 2.0, appendix C.4)."""
    a, b = unit_vectors(first), unit_vectors(second)
    cos = np.einsum("ti,ti->t", a, b)
    b = np.where(cos[:, None] < 0, -b, b)
    angle = np.arccos(np.clip(np.abs(cos), 0, 1))
    sin = np.sin(angle)
    near = sin < 1e-6
    divide = np.where(near, 1, sin)
    w0 = np.where(near, 1 - part, np.sin((1 - part) * angle) / divide)
    w1 = np.where(near, part, np.sin(part * angle) / divide)
    return np.asarray(a * w0[:, None] + b * w1[:, None])


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

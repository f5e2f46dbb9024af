"""Facts about the driver, its memory, contexts that are created and lost, and the largest scene at a display's rate."""

from __future__ import annotations

import ctypes
import gc
import os
import subprocess
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.avatar import Avatar
from glsplat.camera import Camera, stereo_cameras
from glsplat.data import default_avatar
from glsplat.errors import ContextError
from glsplat.extras.evaluate.stability.frame import Case, Outcome, cloud
from glsplat.extras.evaluate.subjects import Subject
from glsplat.gl.context import Context, create_context, egl_devices
from glsplat.gl.functions import gl_functions
from glsplat.io.provenance import machine
from glsplat.renderer import Renderer
from glsplat.skinning.skin import Skin

_ROUNDS = 50
_SETTLED = 20  # rounds after which a driver's caches are filled
_MAX_GROWTH = 1.1  # of the process's memory from then on; a leak of one scene per round gives 1.5 and more
_SPLATS = 20_000
_SIZE = (64, 64)
_LIMITS = (
    "GL_MAX_TEXTURE_SIZE", "GL_MAX_ARRAY_TEXTURE_LAYERS", "GL_MAX_SHADER_STORAGE_BLOCK_SIZE",
    "GL_MAX_VERTEX_SHADER_STORAGE_BLOCKS", "GL_MAX_COMPUTE_WORK_GROUP_INVOCATIONS", "GL_SUBPIXEL_BITS",
)  # fmt: skip
_VARIABLES = ("GALLIUM", "LIBGL", "MESA", "GLSPLAT", "__GL", "__EGL", "CUDA_VISIBLE", "DISPLAY", "WAYLAND")
# KiB; GL_NVX_gpu_memory_info: available memory; GL_ATI_meminfo: free for textures
_FREE_MEMORY = {"GL_NVX_gpu_memory_info": 0x9049, "GL_ATI_meminfo": 0x87FC}

_FEWEST, _MOST = 1_000, 8_192_000  # splats
_HALVINGS = 3  # of the interval between the largest scene that keeps the rate and the smallest that does not


def facts(context: Context) -> dict[str, Any]:
    """Return machine, driver, probed abilities, limits, and the choices of a default renderer of a pair."""
    info, views = context.ctx.info, _pair()
    with Renderer(cloud(), size=_SIZE, views=2, context=context) as renderer:
        renderer.render(views)
        chosen = {**asdict(renderer.variant), "float_target": renderer.target_dtype}
    return {
        **machine(),
        "vendor": info["GL_VENDOR"],
        "driver": context.driver,
        "backend": context.backend,
        "devices": egl_devices(),
        "abilities": {k: getattr(context, k) for k in ("software", "vertex_layers", "vertex_ids", "compute")}
        | {"vertex_storage": context.vertex_storage},
        "limits": {name: info[name] for name in _LIMITS if name in info},
        "chosen": chosen,
        "memory": memory(context),
        "environment": {k: v for k, v in sorted(os.environ.items()) if k.startswith(_VARIABLES)},
    }


def memory(context: Context) -> dict[str, Any]:
    """Return bytes of memory: of the process, free (driver's extension) and used (``nvidia-smi``), if known."""
    found: dict[str, Any] = {"process": resident()}
    with context:
        get = gl_functions(context.ctx)("GetIntegerv", None, ctypes.c_uint, ctypes.POINTER(ctypes.c_int))
        for name, query in _FREE_MEMORY.items():
            if name in context.ctx.extensions:
                values = (ctypes.c_int * 4)()
                get(query, values)
                found[name] = values[0] * 1024
    command = ["nvidia-smi", "--query-gpu=memory.used", "--format=csv,noheader,nounits"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=30)
        found["nvidia-smi"] = [int(line) * 2**20 for line in done.stdout.split()]
    except (OSError, ValueError, subprocess.TimeoutExpired):
        pass  # no NVIDIA driver
    return found


def resident() -> int | None:
    """Return the bytes of memory of this process; None except on Linux."""
    try:
        return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return None


def context_cases(tick: Callable[[float], object]) -> list[Case]:
    """Return the cases of contexts: one lost while in use; 50 created in turn, with their memory.

    Run them while no other context exists: else Mesa's zink (22.3.6) keeps 4 MB of every renderer.
    """

    def refused(_: Context) -> Outcome:
        context = create_context()
        renderer = Renderer(cloud(), size=_SIZE, views=2, context=context)
        renderer.render(_pair())
        context.release()
        try:
            renderer.render(_pair())
        except ContextError as error:
            renderer.release()
            return Outcome("released" in str(error), None, seen=str(error))
        return Outcome(False, None, seen="drawn")

    def made(_: Context) -> Outcome:
        expected, *_rest = _one_life(lost=False)
        used, different = [], 0
        for index in range(_ROUNDS):
            image, held = _one_life(lost=index % 2 == 1)
            different += not np.array_equal(image, expected)
            used.append(held)
            tick((index + 1) / _ROUNDS)
        before, after = used[_SETTLED], used[-1]
        share = after["process"] / before["process"] if before["process"] else 1.0
        words = [f"{different} pictures differ", *(f"{name} {before[name]} to {after[name]} bytes" for name in before)]
        return Outcome(different == 0 and share <= _MAX_GROWTH, share, "times the memory", "; ".join(words))

    return [
        Case("contexts", "a lost context", "released under its renderer", "ContextError", refused),
        Case("contexts", f"{_ROUNDS} contexts", f"{_SPLATS} splats each, every second one lost under its renderer",
             f"the same bytes; at most {_MAX_GROWTH:g} times the memory after the first {_SETTLED}", made),
    ]  # fmt: skip


def _one_life(lost: bool) -> tuple[NDArray[Any], dict[str, Any]]:
    """Return a picture and the memory of a new context, which is released before its renderer if ``lost``."""
    context = create_context()
    renderer = Renderer(cloud(_SPLATS), size=_SIZE, views=2, context=context)
    image, used = renderer.render(_pair()), memory(context)
    for released in (context, renderer) if lost else (renderer, context):
        released.release()
    gc.collect()
    return image, used


def _pair() -> list[Camera]:
    head = np.eye(4)
    head[2, 3] = 3.0
    return list(stereo_cameras(head, 0.2, size=_SIZE))


def frame_ms(context: Context, subject: Subject, frames: int) -> float:
    """Return the median ms of ``frames`` frames of a moving pair, 8 bit and read back, after one warm-up frame."""
    with Renderer(subject.scene, size=(subject.size, subject.size), views=2, context=context) as renderer:
        times = []
        for frame in range(frames + 1):
            renderer.render(subject.views(frame), subject.pose(frame))
            times.append(renderer.timings["total"])
    return float(np.median(times[1:]))


def largest_scene(
    context: Context, size: int = 1024, hertz: float = 72.0, frames: int = 9, tick: Callable[[str], object] = len
) -> dict[str, Any]:
    """Return the most splats whose pair of ``size``² keeps ``hertz``: {"splats" (0: none), "size", "hertz", "tried"}.

    The splats are those of the default avatar at rest, resampled to the same total area.
    """
    avatar, tried = default_avatar(), {}

    def keeps(count: int) -> bool:
        tick(f"{count:,} splats")
        scene: Avatar = resampled(avatar, count)
        tried[count] = round(frame_ms(context, Subject("", scene.splats, size), frames), 3)
        return tried[count] <= 1000 / hertz

    low, high = 0, _FEWEST
    while high <= _MOST and keeps(high):
        low, high = high, 2 * high
    for _ in range(_HALVINGS if 0 < low < _MOST else 0):
        middle = (low + high) // 2
        low, high = (middle, high) if keeps(middle) else (low, middle)
    return {"splats": low, "size": size, "hertz": hertz, "tried": [[n, tried[n]] for n in sorted(tried)]}


def resampled(avatar: Avatar, count: int, seed: int = 0) -> Avatar:
    """Return the avatar with ``count`` splats of the same total area: fewer larger ones, or copies of smaller ones.

    For timing only: copies are randomly offset within their splat.
    """
    have = len(avatar.splats)
    rng = np.random.default_rng(seed)
    times = -(-count // have)
    index = np.sort(rng.permutation(have * times)[:count]) // times
    splats, shrink = avatar.splats.take(index), np.float32(np.sqrt(have / count))
    offset = splats.scales * rng.normal(0, 1, splats.scales.shape).astype(np.float32) if times > 1 else 0
    w, xyz = splats.quats[:, :1], splats.quats[:, 1:]
    turned = offset + 2 * np.cross(xyz, np.cross(xyz, offset) + w * offset) if times > 1 else 0
    moved = replace(splats, means=(splats.means + turned).astype(np.float32), scales=splats.scales * shrink)
    return Avatar(moved, avatar.skeleton, Skin(avatar.skin.joints[index], avatar.skin.weights[index]), avatar.meta)

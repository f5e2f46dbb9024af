"""The scenes of tests/golden/data, their cameras and contract images; CREDITS.md there says who made them."""

from __future__ import annotations

import io
import json
import lzma
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera
from glsplat.formats.camera_file import load_cameras
from glsplat.splats import Splats
from tests.formats.scenes import load_ply

DATA = Path(__file__).parent / "data"

HARD = ("needles", "near_plane", "depth_ties", "huge_coords")
CUDA = ("tiny_case", "basic_case")  # images by gsplat's own kernels
INDEPENDENT = ("demosthenes_10k", "demosthenes_10k_stereo", "playbot_lod3", *HARD, *CUDA)
NAMES = (*INDEPENDENT, "splatapult_sh3_16")  # the last has an image by reference.py


def _original(name: str) -> io.BytesIO:
    """The bytes of a file that may be stored with .xz."""
    path = DATA / name
    return io.BytesIO(path.read_bytes() if path.exists() else lzma.decompress((DATA / f"{name}.xz").read_bytes()))


def _tensors(name: str) -> dict[str, NDArray[np.float32]]:
    data = (DATA / f"{name}.safetensors").read_bytes()
    begin = 8 + int.from_bytes(data[:8], "little")
    table = json.loads(data[8:begin])
    parts = {key: (begin + entry["data_offsets"][0], entry["shape"]) for key, entry in table.items()}
    return {k: np.frombuffer(data, "<f4", int(np.prod(shape)), at).reshape(shape) for k, (at, shape) in parts.items()}


def splats_of(name: str) -> Splats:
    if name in CUDA:
        t = _tensors(name)
        return Splats.create(
            t["means"], t["quats"], np.exp(t["scales"]), 1 / (1 + np.exp(-t["opacities"])), t["coeffs"]
        )
    return load_ply(_original(f"{name.removesuffix('_stereo')}.ply"))


def cameras_of(name: str) -> list[Camera]:
    return list(load_cameras(DATA / f"{name}.camera.json"))


def image_of(name: str) -> NDArray[np.float32]:
    """[V, H, W, 4]"""
    image = _tensors(name)["out_img"] if name in CUDA else np.load(_original(f"{name}.contract.npy"))
    return image if image.ndim == 4 else image[None]

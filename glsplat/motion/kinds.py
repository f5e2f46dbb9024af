"""Which files are motions: said in the help of commands, and told by content."""

from __future__ import annotations

from pathlib import Path

from glsplat.errors import FormatError
from glsplat.extras.formats.npz import array_names
from glsplat.formats.format import Opened
from glsplat.formats.gltf.container import read_container
from glsplat.formats.gltf.nodes import only_moves

__all__ = ["KINDS", "is_bvh", "is_gltf", "is_motion", "split_choice"]

KINDS = "JSON poses, BVH, .amc with its .asf, AMASS .npz, a glTF or VRM animation (.glb, .gltf, .vrm, .vrma)"
"""All that ``load_motion`` reads."""

_LOOKED_AT = 1 << 16  # bytes
_AMASS = {"poses", "pose_body"}


def is_bvh(head: bytes) -> bool:
    """Whether a file that begins so is BVH."""
    return head.removeprefix(b"\xef\xbb\xbf").lstrip()[:9].upper() == b"HIERARCHY"


def is_gltf(head: bytes) -> bool:
    """Whether a file that begins so is glTF: binary, or JSON that says so."""
    return head.startswith(b"glTF") or (head.removeprefix(b"\xef\xbb\xbf").lstrip()[:1] == b"{" and b'"asset"' in head)


def is_motion(start: Opened) -> bool:
    """Whether a file is a motion and nothing else: a glTF that shows something is a model, whatever moves in it."""
    try:
        head = start.begin(_LOOKED_AT)
        if head.startswith(b"PK"):
            start.file.seek(0)
            names = set(array_names(start.file))
            return bool(names & _AMASS) and not names & {"v_template", "vertices", "faces"}
        if is_gltf(head):
            return only_moves(read_container(start.file, start.size, start.folder).gltf)
        text = head.removeprefix(b"\xef\xbb\xbf").lstrip()
        poses = text[:1] in (b"[", b"{") and (b'"frames"' in text or b'"body_pose"' in text)
        return is_bvh(head) or text.startswith((b"#!OML", b":FULLY", b":DEGREES")) or poses
    except FormatError:  # whoever reads it says what is wrong
        return False


def split_choice(name: str) -> tuple[Path, str | None]:
    """A motion's file, and what stands behind a "#": the name or number of an animation in it."""
    at = name.find("#")
    while at > 0 and not Path(name).exists():
        if Path(name[:at]).is_file():
            return Path(name[:at]), name[at + 1 :]
        at = name.find("#", at + 1)
    return Path(name), None

"""A user's map of a rig: {"left_hip": "MyThigh_L", "jaw": null, ...}, SMPL-X joint -> name of a node, or none."""

from __future__ import annotations

from pathlib import Path

from glsplat.errors import FormatError
from glsplat.io.files import naming, read_json
from glsplat.skinning.smplx import JOINT_NAMES

_LARGEST = 1 << 20  # bytes


def read_rig_map(path: str | Path) -> dict[str, str | None]:
    """Read the map from a JSON file. Raises FormatError naming the file and the entry."""
    with naming(path):
        found = read_json(path, "a rig map", _LARGEST)
        if not isinstance(found, dict) or not found:
            raise FormatError('a rig map is an object of names, {"left_hip": "MyThigh_L", "jaw": null, ...}')
        for joint, name in found.items():
            if joint not in JOINT_NAMES:
                raise FormatError(f'a rig map names joints of SMPL-X (left_hip, ...), not "{joint:.40}"')
            if name is not None and not isinstance(name, str):
                raise FormatError(f"{joint} needs the name of a node, or null, not {name!r:.40}")
        return found

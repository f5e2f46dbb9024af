"""A user's own map of a rig: {"left_hip": "MyThigh_L", "jaw": null, ...}, SMPL-X joint -> name of a node, or none."""

from __future__ import annotations

import json
from pathlib import Path

from glsplat.errors import FormatError
from glsplat.io.files import naming, open_regular
from glsplat.skinning.smplx import JOINT_NAMES

_LARGEST = 1 << 20  # bytes


def read_rig_map(path: str | Path) -> dict[str, str | None]:
    """The map in a JSON file. Raises FormatError naming the file and the entry."""
    with naming(path):
        with open_regular(path) as (file, size):
            if size > _LARGEST:
                raise FormatError(f"a rig map has at most {_LARGEST} bytes, this file {size}")
            text = file.read()
        try:
            found = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise FormatError(f"a rig map is JSON, but {str(error)[:80]}") from None
        if not isinstance(found, dict) or not found:
            raise FormatError('a rig map is an object of names, {"left_hip": "MyThigh_L", "jaw": null, ...}')
        for joint, name in found.items():
            if joint not in JOINT_NAMES:
                raise FormatError(f'a rig map names joints of SMPL-X (left_hip, ...), not "{joint:.40}"')
            if name is not None and not isinstance(name, str):
                raise FormatError(f"{joint} needs the name of a node, or null, not {name!r:.40}")
        return found

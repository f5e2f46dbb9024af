"""Explain why SMPL-X's motions do not move another program's rig, for messages."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from glsplat.errors import PoseError
from glsplat.extras.rigs.humanoid import upright
from glsplat.extras.rigs.match import match_rig
from glsplat.skinning.skeleton import Skeleton


def why_undriven(skeleton: Skeleton) -> str:
    """Return the reason in one line, with the joints that are missing, for a rig that is not SMPL-X's."""
    names = skeleton.names
    try:
        with np.errstate(all="ignore"):  # joints of 1e300 m
            found = match_rig(names, skeleton.parents, skeleton.joints)
            if found.missing:
                return f"no joint for {', '.join(found.missing)} among its {len(names)} ({_some(names)})"
            upright(found, skeleton.joints)
    except PoseError as error:
        return str(error)
    other = next(f"{name} is {_plain(names[index])}" for name, index in found.joints.items() if names[index] != name)
    return f"its joints are another rig's ({other}, ...); glsplat avatar import puts it on the 55 of SMPL-X"


def _some(names: Sequence[str]) -> str:
    return ", ".join(_plain(name) for name in names[:4]) + (", ..." if len(names) > 4 else "")


def _plain(name: str) -> str:
    """Return the start of a name, without characters that break the line or control the terminal."""
    return "".join(c if c.isprintable() else "?" for c in name[:24])

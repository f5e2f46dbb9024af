"""The library of templates: hair and shoes on the open body, and the detail of a hand's skin (licence in data/)."""

from __future__ import annotations

from functools import lru_cache
from importlib import resources

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import frozen
from glsplat.errors import FormatError
from glsplat.extras.formats.person import read_person
from glsplat.extras.formats.texture import decode_texture
from glsplat.meshes import RiggedMesh

HAIR = "short01 short02 short03 short04 bob01 bob02 long01 ponytail01 braid01 afro01".split()
"""Names of the hair templates, bound to the head."""

SHOES = "shoes01 shoes02 shoes03 shoes05".split()
"""Names of the shoe templates, a pair each, bound to ankles and feet."""

SHOE_TOP_M = -0.6129
"""Height in the zero pose and shape below which a shoe template hides the open body."""

_DATA = resources.files(__package__) / "data"


@lru_cache(maxsize=len(HAIR) + len(SHOES))
def template(name: str) -> RiggedMesh:
    """Return a template of the library on the open body's zero shape and pose, metres; it has one part.

    It is read once. Raises FormatError for a name that is neither in ``HAIR`` nor in ``SHOES``.
    """
    if name not in (*HAIR, *SHOES):
        raise FormatError(f"the templates are {', '.join((*HAIR, *SHOES))}, not {name!r}")
    with resources.as_file(_DATA / f"{name}.npz") as path:
        return read_person(path)


def hand_skin() -> NDArray[np.uint8]:
    """Return the texture [512, 512, 3] of the open body's skin in sRGB, whose hands are used; row 0 is v = 1."""
    return frozen(decode_texture((_DATA / "hand_skin.jpg").read_bytes(), "hand_skin.jpg")[..., :3])

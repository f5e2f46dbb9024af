"""The default avatar with one splat in three: what a test can draw quickly on any machine."""

from __future__ import annotations

from dataclasses import replace
from datetime import date, timedelta
from pathlib import Path

import numpy as np

from glsplat.data import default_avatar
from glsplat.extras.consent.file import sign_file
from glsplat.extras.consent.keys import new_key
from glsplat.formats import save
from glsplat.skinning.skin import Skin

__all__ = ["light_avatar"]


def light_avatar(folder: Path) -> Path:
    """A .glb in ``folder``, whose splats may be handed out."""
    avatar = default_avatar()
    some = np.arange(0, len(avatar.splats), 3)
    skin = Skin(avatar.skin.joints[some], avatar.skin.weights[some])
    path = folder / "light.glb"
    save(replace(avatar, splats=avatar.splats.take(some), skin=skin, shapes=None), path)
    whose = {"subject": "nobody", "given_by": "nobody", "purpose": "tests", "drivers": ["*"], "hand_out": True}
    days = {"start": date.today() - timedelta(days=2), "until": date.today() + timedelta(days=9)}
    sign_file(path, path, new_key(folder / "key"), **whose, **days)
    return path

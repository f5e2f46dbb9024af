"""Trivial reconstructors: they record their inputs and return the embedded avatar, or fail."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from glsplat.avatar import Avatar
from glsplat.data import default_avatar
from glsplat.extras.authoring.body.open_body import open_body
from glsplat.extras.authoring.check import photos
from glsplat.extras.authoring.check.capture import Capture, Finding
from glsplat.extras.authoring.dress.fitted_mesh import dressed_mesh
from glsplat.extras.authoring.fit.body_fit import fit_body
from glsplat.extras.authoring.fit.view import View
from glsplat.extras.authoring.paint.bake import bake
from glsplat.extras.authoring.reconstruct.builtin import FittedBody, MadeAvatar
from tests.extras.authoring.paint.scene import photographed

__all__ = ["Detailed", "Meshed", "Plain", "fitting", "misfitting", "replace_check", "small_avatar"]


def replace_check(monkeypatch: Any) -> dict[str, tuple[Finding, ...]]:
    """Replace the check by the findings of a dictionary for each side; no network runs."""
    findings: dict[str, tuple[Finding, ...]] = {}

    def check(picture: Any, view: str = "front", known_mask: Any = None) -> Capture:
        mask = np.ones(picture.shape[:2], bool) if known_mask is None else known_mask
        nobody = any(finding.code == "nobody" for finding in findings.get(view, ()))
        return Capture(findings.get(view, ()), None if nobody else Nobody(), mask)  # type: ignore[arg-type]

    monkeypatch.setattr(photos, "check_capture", check)
    monkeypatch.setattr(photos, "find_person", lambda picture: None)
    return findings


def _marks(count: int, columns: int) -> Any:
    return SimpleNamespace(points=np.linspace(20, 40, count * columns).reshape(count, columns), presence=0.9)


class Nobody:
    """Stands where a person would: landmarks on a line."""

    body = SimpleNamespace(points=np.linspace(20, 40, 66).reshape(33, 2), visible=np.ones(33))
    face, left_hand, right_hand = _marks(468, 3), _marks(21, 2), _marks(21, 2)


def small_avatar(count: int = 200) -> Avatar:
    """A few splats of the embedded person, without notes."""
    avatar = default_avatar()
    keep = np.zeros(len(avatar.splats), bool)
    keep[:: len(keep) // count] = True
    splats = replace(avatar.splats.take(keep), cones=None)
    return replace(avatar, splats=splats, skin=avatar.skin.take(keep), shapes=None, meta={})


@dataclass
class Plain:
    """A minimal reconstructor."""

    result: Any = field(default_factory=small_avatar)
    calls: list[tuple[Any, Any, Any]] = field(default_factory=list)

    def reconstruct(self, pictures: Any, masks: Any, options: Any) -> Any:
        self.calls.append((pictures, masks, options))
        options.progress("standing in", 0.5)
        if isinstance(self.result, Exception):
            raise self.result
        return self.result


@dataclass
class Detailed(Plain):
    """A reconstructor that returns the fitted body too; with ``fitted`` from a real fit."""

    problem: str = ""
    fitted: bool = False

    def report(self, pictures: Any, masks: Any, options: Any) -> MadeAvatar:
        self.calls.append((pictures, masks, options))
        view = SimpleNamespace(overlap=0.5, landmark_error=9.0, uncertainty={})
        mesh, fit = None, SimpleNamespace(views=[view] * len(pictures), stature=1.7)
        if self.fitted:
            views = []
            for side, picture in pictures.items():
                body = picture.person.body
                focal = picture.focal or 1.2 * max(picture.rgb.shape)
                views.append(View(masks[side], body.points, body.visible, focal, side=side))
            fit = fit_body(views, options.height)
            mesh = dressed_mesh(open_body(), fit)
        return MadeAvatar(avatar=self.result, fit=fit, mesh=mesh, unseen=0.43, seen=np.zeros(0), problem=self.problem)  # type: ignore[arg-type]


@dataclass
class Meshed(Detailed):
    """A reconstructor that makes meshes too: a synthetic body in one colour."""

    def mesh(self, pictures: Any, masks: Any, options: Any) -> FittedBody:
        self.calls.append((pictures, masks, options))
        person = photographed("front")
        mesh = bake(person.mesh, lambda points: np.full((len(points.corners), 3), 0.3), options.texture)
        view = SimpleNamespace(overlap=0.5, landmark_error=9.0, uncertainty={})
        fit: Any = SimpleNamespace(views=[view] * len(pictures), stature=1.7)
        return FittedBody(fit=fit, mesh=mesh, unseen=0.43, seen=np.zeros(0), problem=self.problem)


def fitting() -> Detailed:
    """One that fits a real body to the pictures, and has a whole avatar."""
    return Detailed(small_avatar(40_000), fitted=True)


def misfitting() -> Detailed:
    """A reconstructor whose body does not fit."""
    return Detailed(problem="far off")

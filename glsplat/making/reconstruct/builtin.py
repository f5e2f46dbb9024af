"""The built-in way: the open body fitted to the pictures, dressed, and painted with what they show."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from glsplat.avatar import Avatar
from glsplat.errors import FormatError
from glsplat.making.fit.body import open_body
from glsplat.making.fit.details import fit_details
from glsplat.making.fit.eyes import read_eyes
from glsplat.making.fit.fit import BodyFit, fit_body
from glsplat.making.fit.view import View
from glsplat.making.networks.people import Person, find_person
from glsplat.making.paint.dress import dressed_mesh
from glsplat.making.paint.paint import paint
from glsplat.making.paint.scatter import scatter
from glsplat.making.paint.sharpen import sharpened
from glsplat.making.paint.shot import Shot
from glsplat.making.reconstruct.reconstructor import Mask, Options, Picture
from glsplat.meshes import RiggedMesh

__all__ = ["SIDES", "Builtin", "Made", "Telling"]

SIDES = ("front", "back", "left", "right")
_HARDLY = 0.1  # of a point that a picture shows too flatly to be believed
_PHONE = 1.37  # focal length of a usual phone camera, in heights of an upright picture


@dataclass(frozen=True, eq=False)
class Made:
    """An avatar, and how it came about."""

    avatar: Avatar
    fit: BodyFit
    mesh: RiggedMesh  # the dressed body in the zero pose
    unseen: float  # share of the surface that no picture shows
    seen: NDArray[np.float64]  # [V] of its vertices, from 0 guessed to 1 seen squarely
    problem: str  # one line, or empty


@runtime_checkable
class Telling(Protocol):
    """A reconstructor that can say how its avatar came about."""

    def tell(self, pictures: Mapping[str, Picture], masks: Mapping[str, Mask], options: Options) -> Made:
        """As ``reconstruct``, with all that led to the avatar."""
        ...


class Builtin:
    """Fits, dresses and paints; needs the networks of ``glsplat models get``."""

    def reconstruct(self, pictures: Mapping[str, Picture], masks: Mapping[str, Mask], options: Options) -> Avatar:
        """An avatar; see ``Reconstructor``."""
        return self.tell(pictures, masks, options).avatar

    def tell(self, pictures: Mapping[str, Picture], masks: Mapping[str, Mask], options: Options) -> Made:
        """The avatar with all that led to it."""
        if "front" not in pictures:
            raise FormatError("an avatar needs a picture of the front")
        sides = [side for side in SIDES if side in pictures]
        options.progress("reading landmarks", 0.0)
        people = {side: pictures[side].person or _person(pictures[side], side) for side in sides}
        views = [_view(side, pictures[side], masks[side], people[side]) for side in sides]
        options.progress("fitting the body", 0.15)
        body = open_body()
        fit = fit_body(views, options.height, body)
        fit = fit_details(fit, views, [people[side] for side in sides], body)
        options.progress("painting", 0.35)
        mesh = dressed_mesh(body, fit)
        shots = [
            Shot(pictures[side].rgb, masks[side], view.focal, fitted, mesh)
            for side, view, fitted in zip(sides, views, fit.views, strict=True)
        ]
        rng = np.random.default_rng(options.seed)
        strewn = scatter(mesh, options.splats, rng)
        looks = read_eyes(pictures["front"].rgb, people["front"].face)
        painted = paint(body, shots, strewn.points, looks)
        options.progress("placing splats", 0.6)
        avatar = strewn.avatar(mesh, painted.rgb, painted.busy, rng)
        if options.steps:
            options.progress("fitting to the pictures", 0.7)
            avatar = sharpened(avatar, shots, options.steps)
        unseen = float(np.average(painted.seen < _HARDLY, weights=1 / strewn.density))
        seen = np.max([shot.trust for shot in shots], axis=0)
        options.progress("placing splats", 1.0)
        return Made(avatar, fit, mesh, unseen, seen, fit.problem)


def _person(picture: Picture, side: str) -> Person:
    person = find_person(picture.rgb)
    if person is None:
        raise FormatError(f"nobody is found in the {side} picture; show one whole person, upright")
    return person


def _view(side: str, picture: Picture, mask: Mask, person: Person) -> View:
    focal = picture.focal or _PHONE * max(picture.rgb.shape[:2])
    return View(mask, person.body.points, person.body.visible, focal, side=side)

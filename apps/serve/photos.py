"""Make the avatars of --allow-upload by this package's own reconstructor, in a process of its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from glsplat.avatar import Avatar
from glsplat.errors import FormatError
from glsplat.extras.uploads.job import LowConfidenceError, Order, Progress, UploadConfig
from glsplat.net.guard.access import is_loopback

from ..usage import UsageError
from .options import ServeOptions

_CONSENT = "whoever sent the photograph said: this is me, or this person agreed"


def upload_config(args: ServeOptions) -> UploadConfig | None:
    """Return how avatars are made of uploads; None where clients may not send any.

    Raises UsageError, or GlsplatError where a network is missing.
    """
    if args.allow_upload is None:
        return None
    if args.cull_hidden:
        raise UsageError("cull-hidden needs avatars with cones, those of --allow-upload have none: leave one out")
    from glsplat.extras.authoring.models.catalogue import PHOTO  # here: other servers run without scipy
    from glsplat.extras.authoring.models.store import path_of

    for model in PHOTO.models:
        path_of(model.name)
    # on its user's own machine drawing yields to the work (net/server.py); elsewhere drawing for others goes first
    config = UploadConfig(folder=args.allow_upload, make=make_avatar)
    return replace(config, nice=0) if is_loopback(args.host) and not args.trusted_proxy else config


def make_avatar(order: Order, progress: Progress) -> Avatar:
    """Return an avatar of the order's pictures. Raises LowConfidenceError for findings of the check, GlsplatError."""
    # imported in the process that does the work
    from glsplat.errors import CaptureError
    from glsplat.extras.authoring.check.photos import check_photos, refuse
    from glsplat.extras.authoring.photo.photo_file import Photo, decode_photo
    from glsplat.extras.authoring.reconstruct.photos import reconstruct
    from glsplat.extras.authoring.reconstruct.reconstructor import Options

    def photo(side: str) -> Photo | None:
        if side not in order.pictures:
            return None
        try:
            return decode_photo(order.pictures[side])
        except FormatError as error:
            raise FormatError(f"{side} picture: {error}") from None

    front = photo("front")
    assert front is not None
    options = Options(height=order.height, progress=progress)
    shots = check_photos(front, back=photo("back"), left=photo("left"), right=photo("right"), progress=progress)

    def make() -> Avatar:
        notes = {"consent": _CONSENT} | ({"title": order.title} if order.title else {})
        try:
            done = reconstruct(shots, options, anyway=True, meta=notes)
        except CaptureError as error:  # of what nobody is found in
            raise LowConfidenceError(str(error), error.findings) from None
        if not order.anyway and not refused:  # what was refused once is wanted all the same
            hold(partial(refuse, shots, done.made.problem if done.made else ""), lambda: done.avatar)
        return done.avatar

    def hold(check: Callable[[], None], then: Callable[[], Avatar]) -> None:
        try:
            check()
        except CaptureError as error:
            refused.append(error)
            nobody = any(shot.capture.person is None for shot in shots.values())
            raise LowConfidenceError(str(error), error.findings, None if nobody else then) from None

    refused: list[CaptureError] = []
    if not order.anyway:
        hold(partial(refuse, shots), make)
    return make()

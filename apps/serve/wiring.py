"""The server of ``glsplat serve``: what the core serves, with the extras that the options ask for."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

from glsplat.data import person
from glsplat.errors import GlsplatError
from glsplat.net.backend import AvatarInfo
from glsplat.net.backends.avatar_store import AvatarStore
from glsplat.net.backends.gl import MAX_PICTURE_S
from glsplat.net.drawer import Drawer
from glsplat.net.feature import Feature
from glsplat.net.options import ServerConfig
from glsplat.net.served_scene import ServedScene, checked_avatar, log_limits, server_of
from glsplat.net.server import Server
from glsplat.net.worker.process import process_worker
from glsplat.net.worker.worker import Worker
from glsplat.scene import Rigged

if TYPE_CHECKING:
    from glsplat.extras.consent.policy import ConsentPolicy
    from glsplat.extras.uploads.job import UploadConfig
    from glsplat.extras.workers.pool import Workers

log: logging.Logger = logging.getLogger("glsplat.net")


def assemble(
    served: ServedScene,
    config: ServerConfig,
    *,
    device: str | None = None,  # EGL device: index or part of its name; with workers several, with commas between
    max_cost: float | None = None,  # pixels that a picture may cover; None: max_cost_of
    max_time: float = MAX_PICTURE_S,  # seconds that a picture may take
    workers: Workers | None = None,  # draw and encode instead of one process (docs/scaling.md)
    uploads: UploadConfig | None = None,  # lets clients have avatars made of photographs
    consent: ConsentPolicy | None = None,  # of all that is shown, by the same names
    people: Collection[str] = (),  # of glsplat.data.PEOPLE, to offer soon after the start
    features: Sequence[Feature] = (),
) -> Server:
    """Return the server of a scene; nothing is opened before it starts.

    Avatars in the folder of ``uploads`` are offered from the start, those made later as they come. Raises GlsplatError
    for names that no client could request.
    """
    config = replace(served.configured(config), consent=consent)
    offers = served.offers()
    choices: Mapping[str, Rigged] = served.avatars
    if uploads is not None:
        feature, kept = _uploads(uploads, served, consent)
        features = (feature, *features)
        offers += kept
    log_limits(offers)
    if people or uploads is not None:
        folder = None if uploads is None else uploads.folder
        choices = AvatarStore(served.avatars, folder, served.name, people)
    devices = [device] if workers is None or device is None else device.split(",")
    more: dict[str, Any] = {"avatars": choices, "max_cost": max_cost, "max_time": max_time}
    if workers is not None:
        more["name"] = served.name
    makes = [served.backend(config.wire.size, device=one, **more) for one in devices]
    backend: Worker | Drawer
    if workers is None:
        backend = process_worker(makes[0], config.wire.max_side, max_time)
    else:
        backend = workers.pool(makes, config.fps, max_time, config.video)
    taken = {one.name for one in offers}
    later = partial(_people, [name for name in people if name not in taken], served, consent)
    return server_of(backend, config, offers, features, later)


def _people(names: Collection[str], served: ServedScene, consent: ConsentPolicy | None) -> Iterator[AvatarInfo]:
    """Yield the embedded people of ``names`` but the one who is the scene; each is loaded when it is its turn."""
    for name in names:
        avatar = person(name)
        if avatar is served.avatar:
            continue
        try:
            checked_avatar(name, avatar, served.rendering)
        except GlsplatError as error:  # without visibility cones
            log.info("%s", error)
            continue
        if consent is not None:
            from glsplat.extras.consent.file import OnFile

            consent.add(name, [OnFile(nobody=True)])
        yield served.tracking.describe(name, avatar)


def _uploads(
    config: UploadConfig, served: ServedScene, consent: ConsentPolicy | None
) -> tuple[Feature, list[AvatarInfo]]:
    """Return the feature that makes avatars, and the offered avatars of its folder.

    Raises GlsplatError for a name that is taken.
    """
    from glsplat.extras.uploads.routes import Uploads

    def describe(name: str, avatar: Rigged) -> AvatarInfo:
        checked_avatar(name, avatar, served.rendering)
        return replace(served.tracking.describe(name, avatar), made=uploads.store.made_here(name))

    uploads = Uploads(config, describe)
    uploads.store.open()
    found = uploads.store.avatars()
    for name in found:
        if name in (served.name, *served.avatars):
            raise GlsplatError(f'{config.folder}: two avatars are called "{name}": clients choose by name, rename one')
    agrees: Callable[[str], bool] = partial(_agreed, config=config, consent=consent)
    return uploads, [describe(name, avatar) for name, avatar in found.items() if agrees(name)]


def _agreed(name: str, config: UploadConfig, consent: ConsentPolicy | None) -> bool:
    """Return whether an avatar of the folder may be offered; one that may not is logged."""
    from glsplat.extras.consent.file import on_file
    from glsplat.extras.uploads.upload_store import SUFFIX

    if consent is not None:
        path = config.folder / f"{name}{SUFFIX}"
        consent.add(name, [on_file(path)])
        try:
            consent.check(name, time.time())
        except GlsplatError as error:
            log.warning("%s: skipped: %s", path, error)
            return False
    return True

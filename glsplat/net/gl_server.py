"""A server that works: what this package draws and solves with, behind glsplat.net.server.Server."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from glsplat.avatar import Avatar
from glsplat.config import RenderConfig
from glsplat.data import person
from glsplat.errors import GlsplatError
from glsplat.extras.browser.web_format.write import web_file
from glsplat.net.backend import AvatarInfo, Backend
from glsplat.net.backends.avatar_store import AvatarStore, WithPeople
from glsplat.net.backends.gl import MAX_TIME, RendererBackend
from glsplat.net.backends.tracking import TrackingSolver
from glsplat.net.drawer import Drawer
from glsplat.net.feature import Feature
from glsplat.net.messages import PARTS
from glsplat.net.options import NAME, ServerConfig
from glsplat.net.server import Server
from glsplat.net.standard_server import server_of
from glsplat.net.worker.process import process_worker
from glsplat.net.worker.worker import Worker
from glsplat.scene import Rigged, SceneLike, is_rigged
from glsplat.scenes.scene_file import SceneFile
from glsplat.skinning.driven import why_not_driven, why_not_tracked
from glsplat.tracking.calibration import EYES_OF_STATURE, Calibration
from glsplat.tracking.solve.body import Body
from glsplat.tracking.solvers import SOLVERS, SolverName

if TYPE_CHECKING:  # a plain server runs without these rooms: tests/test_alone.py
    from glsplat.extras.consent.policy import ConsentPolicy
    from glsplat.extras.speech.face.feed import FaceFeed
    from glsplat.extras.uploads.job import UploadConfig
    from glsplat.extras.uploads.routes import Uploads
    from glsplat.extras.workers.options import Workers

__all__ = ["SEATS", "make_server", "offered"]

log: logging.Logger = logging.getLogger("glsplat.net")

_NAME = 64  # characters
SEATS = 8
"""People that a room holds unless it is said."""


def make_server(
    scene: SceneLike | SceneFile,
    config: ServerConfig | None = None,
    device: str | None = None,  # EGL device: index or part of its name
    calibration: Calibration | None = None,  # of users who do not tell their height
    own_process: bool = True,
    rendering: RenderConfig | None = None,
    budget: tuple[float | None, float] = (None, MAX_TIME),  # of a picture: covered pixels (None: most_cost), seconds
    name: str = "default",  # of the scene, among the avatars that clients choose from
    avatars: Mapping[str, Rigged] | None = None,  # others that clients may choose, by name
    uploads: UploadConfig | None = None,  # lets clients have avatars made of photographs; None: they may not
    solver: SolverName = SOLVERS[0],  # what guesses the body of users who send head and hands
    rooms: Mapping[str, SceneLike | SceneFile] | None = None,  # in which clients meet: what stands there already
    consent: ConsentPolicy | None = None,  # of all that is shown, by the same names; None: nobody asks for it
    workers: Workers | None = None,  # that draw and encode instead (docs/scaling.md)
    idle: bool = False,  # eyes of tracked users that no sensor sees look around and blink
    face: FaceFeed | None = None,  # a face that is tracked beside the headset, of one user at a time
    features: Sequence[Feature] = (),  # more of them, such as a study
    title: str = "",  # what people read for ``name``; "": as its file says
    people: Collection[str] = (),  # names of glsplat.data.PEOPLE that clients may choose, too, soon after the start
) -> Server:
    """A server that draws ``scene`` with OpenGL, and solves tracking if its one avatar has SMPL-X's rig.

    The poses of clients are for the one visible avatar, which may be a rigged mesh; with several a pose is refused,
    without any it does nothing.
    The motions of a scene file play on the server's clock. Clients see the scene, or whom of ``avatars`` they name in
    their address (/ws?avatar=NAME); each is posed and tracked by its own skeleton. Of ``uploads`` the folder's avatars
    are offered from the start, those made later as they come. Clients who name one of ``rooms`` are people of one scene
    (/ws?room=NAME&name=ANN); ``config.rooms`` may say how many each holds. ``own_process`` draws in a process of its
    own, else in a thread; with ``workers`` they draw, and the processes of this machine take turns with the devices
    that ``device`` names, with commas between. Nothing else is opened before ``await server.start()`` or
    ``await server.run()``::

        asyncio.run(make_server(glsplat.load("me.glb"), ServerConfig(port=8000)).run())
    """
    config = replace(config or ServerConfig(), consent=consent)
    file = scene if isinstance(scene, SceneFile) else SceneFile.of(scene)
    config = replace(config, wire=replace(config.wire, light=file.scene.light))
    item = file.avatar
    avatar = item.content if item is not None and is_rigged(item.content) else None
    others = _checked(avatars or {}, name, rendering)
    choices: Mapping[str, Rigged] = others
    first = _nobody(name, file) if avatar is None else offered(name, avatar, calibration, solver, idle, face)
    first = replace(first, title=title or first.title)
    offers = [first, *(offered(one, what, calibration, solver, idle, face) for one, what in others.items())]
    takes = None
    if uploads is not None:
        choices = AvatarStore(others, uploads.folder, name)
        takes, kept = _uploads(uploads, rendering, calibration, {name, *others}, solver, consent, idle, face)
        offers += kept
    if people:
        choices = WithPeople(choices, people)
    for one in offers:
        _say(one)
    places = {one: what if isinstance(what, SceneFile) else SceneFile.of(what) for one, what in (rooms or {}).items()}
    furnished = frozenset(one for one, place in places.items() if place.scene.items)
    config = replace(config, rooms={one: config.rooms.get(one, SEATS) for one in places}, furnished=furnished)
    devices = [device] if workers is None or device is None else device.split(",")
    base = partial(RendererBackend, file.scene, config.wire.size, avatars=choices, rooms=places)
    draws = [partial(base, device=one, config=rendering, max_cost=budget[0], max_time=budget[1]) for one in devices]
    if file.motions:  # in one pickle with the scene, so that the items are the same
        draws = [partial(draw, pose_at=file.pose_at) for draw in draws]
    backend: Backend | Worker | Drawer
    if workers is not None:
        backend = workers.pool([partial(draw, name=name) for draw in draws], config.fps, budget[1], config.video)
    else:
        backend = process_worker(draws[0], config.wire.max_side, budget[1]) if own_process else draws[0]()
    taken = {one.name for one in offers}
    later = partial(
        _people,
        [one for one in people if one not in taken],
        avatar,
        rendering,
        partial(offered, calibration=calibration, solver=solver, idle=idle, face=face),
        consent,
    )
    features = features if takes is None else (takes, *features)
    return server_of(backend, config, offers, features, later)


def _people(
    names: Collection[str],
    shown: object,
    rendering: RenderConfig | None,
    describe: Callable[[str, Rigged], AvatarInfo],
    consent: ConsentPolicy | None,
) -> Iterator[AvatarInfo]:
    """The embedded people of ``names``, but the one who is ``shown`` anyway; each is loaded when it is its turn."""
    for name in names:
        avatar = person(name)
        if avatar is shown:
            continue
        try:
            _checked({name: avatar}, "", rendering)
        except GlsplatError as error:  # without what this server draws by
            log.info("%s", error)
            continue
        if consent is not None:
            from glsplat.extras.consent.file import OnFile

            consent.add(name, [OnFile(nobody=True)])
        yield describe(name, avatar)


def _say(one: AvatarInfo) -> None:
    """What clients ask for in vain: at start, before somebody in a headset wonders."""
    if one.still:
        log.warning('"%s": poses and tracking are not applied: %s; clients move the camera', one.name, one.still)
    elif one.untracked:
        what = "motions and tracking are" if one.skeleton is None or why_not_driven(one.skeleton) else "tracking is"
        how = "" if one.skeleton is None else ", and its joints by their names"
        log.warning('"%s": %s not applied: %s; clients move the camera%s', one.name, what, one.untracked, how)


def _nobody(name: str, file: SceneFile) -> AvatarInfo:
    """A scene of which no client sets a pose: nobody is there, or several are."""
    if file.scene.figures:
        return AvatarInfo(name=name, untracked="the scene has several avatars, each does what the scene file says")
    why = why_not_driven(None)
    return AvatarInfo(name=name, untracked=why, still=why)


def _uploads(
    config: UploadConfig,
    rendering: RenderConfig | None,
    calibration: Calibration | None,
    taken: Collection[str],
    solver: SolverName,
    consent: ConsentPolicy | None,
    idle: bool,
    face: FaceFeed | None,
) -> tuple[Uploads, list[AvatarInfo]]:
    """What makes avatars, and what is offered of its folder; GlsplatError where a name there is ``taken``."""
    from glsplat.extras.uploads.routes import Uploads

    def describe(one: str, avatar: Rigged) -> AvatarInfo:
        _checked({one: avatar}, "", rendering)
        return replace(offered(one, avatar, calibration, solver, idle, face), made=uploads.store.made_here(one))

    uploads = Uploads(config, describe)
    uploads.store.open()
    found = uploads.store.avatars()
    for one in found:
        if one in taken:
            raise GlsplatError(f'{config.folder}: two avatars are called "{one}": clients choose by name, rename one')
    return uploads, [describe(one, avatar) for one, avatar in found.items() if _agreed(one, config, consent)]


def _agreed(name: str, config: UploadConfig, consent: ConsentPolicy | None) -> bool:
    """Whether an avatar of the folder may be offered; what may not is said."""
    from glsplat.extras.consent.file import on_file
    from glsplat.extras.uploads.upload_store import SUFFIX

    if consent is not None:
        path = config.folder / f"{name}{SUFFIX}"
        consent.add(name, [on_file(path)])
        try:
            consent.check(name, time.time())
        except GlsplatError as error:
            log.warning("%s: left out: %s", path, error)
            return False
    return True


def offered(
    name: str,
    avatar: Rigged,
    calibration: Calibration | None = None,
    solver: SolverName = SOLVERS[0],
    idle: bool = False,
    face: FaceFeed | None = None,
) -> AvatarInfo:
    """What clients may ask of an avatar.

    ``calibration`` is of users who tell neither height nor arm span; without it their size is found.
    Tracking is solved for SMPL-X's rig.
    """
    skeleton = avatar.skeleton
    parts = frozenset(part for part in PARTS if part in skeleton.names)
    file = partial(web_file, avatar) if isinstance(avatar, Avatar) else None
    said = avatar.meta.get("title") if isinstance(avatar, Avatar) else None
    title = said if isinstance(said, str) and NAME.fullmatch(said) else ""  # a file may say anything
    if why := why_not_tracked(skeleton):
        return AvatarInfo(name=name, title=title, skeleton=skeleton, parts=parts, untracked=why, file=file)
    height = Body.of(skeleton).eye_height / EYES_OF_STATURE
    base = calibration or Calibration(automatic=True)

    def solving(height: float | None, span: float | None) -> TrackingSolver:
        fitted = base if height is None else Calibration.of_height(skeleton, height, base.floor)
        fitted = fitted if span is None else fitted.with_span(skeleton, span)
        return TrackingSolver(skeleton, fitted, solver, idle, face)

    return AvatarInfo(name=name, title=title, skeleton=skeleton, solver=solving, height=height, parts=parts, file=file)


def _checked(avatars: Mapping[str, Rigged], scene: str, rendering: RenderConfig | None) -> dict[str, Rigged]:
    """The avatars by names that an address can hold. Raises GlsplatError for what no client could ask for."""
    for name, avatar in avatars.items():
        if not (isinstance(name, str) and 0 < len(name) <= _NAME and name.isprintable() and name.strip() == name):
            raise GlsplatError(f"an avatar's name needs 1 to {_NAME} printable characters, not {name!r:.80}")
        if name == scene:
            raise GlsplatError(f'two avatars are called "{name}": clients choose by name, give one another')
        if not is_rigged(avatar):
            raise GlsplatError(f'"{name}": clients choose avatars, not {type(avatar).__name__} without joints to move')
        splats = avatar.splats if isinstance(avatar, Avatar) else None
        if rendering is not None and rendering.cull_hidden is True and splats is not None and splats.cones is None:
            raise GlsplatError(f'"{name}": cull_hidden needs visibility cones; make them (glsplat avatar cones)')
    return dict(avatars)

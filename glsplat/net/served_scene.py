"""The scene, avatars and rooms of a server, and the server that draws them with OpenGL."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any

from glsplat.avatar import Avatar
from glsplat.config import RenderConfig
from glsplat.errors import GlsplatError
from glsplat.formats.scene_file import SceneFile
from glsplat.net.backend import AvatarInfo, Backend
from glsplat.net.backends.gl import MAX_PICTURE_S, RendererBackend
from glsplat.net.catalogue import Catalogue
from glsplat.net.drawer import Drawer
from glsplat.net.feature import Feature
from glsplat.net.messages import PARTS
from glsplat.net.options import DEFAULT_SEATS, NAME, ServerConfig
from glsplat.net.pages import Pages
from glsplat.net.render_loop import RenderLoop
from glsplat.net.server import Server
from glsplat.net.worker.encoding import PictureEncoder
from glsplat.net.worker.process import process_worker
from glsplat.net.worker.worker import ThreadWorker, Worker
from glsplat.optional import missing, plugin
from glsplat.scene import Rigged, SceneLike, is_rigged
from glsplat.skinning.driven import why_not_driven, why_not_tracked
from glsplat.tracking.solvers import SOLVERS, SolverName

if TYPE_CHECKING:
    from glsplat.net.backends.tracking import FaceFeed, TrackingSolver
    from glsplat.tracking.calibration import Calibration

log: logging.Logger = logging.getLogger("glsplat.net")
clock: Callable[[], float] = time.perf_counter

_MAX_NAME_CHARS = 64  # characters


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackingOptions:
    """Options of the tracking solver."""

    calibration: Calibration | None = None  # of users who send neither height nor arm span; None: it is estimated
    solver: SolverName = SOLVERS[0]
    idle: bool = False  # animate eyes that are not tracked: gaze and blinks
    face: FaceFeed | None = None  # face tracking from outside the headset, of one user at a time

    def describe(self, name: str, avatar: Rigged) -> AvatarInfo:
        """Return the catalogue's entry of an avatar. Tracking is solved for SMPL-X's rig."""
        skeleton = avatar.skeleton
        parts = frozenset(part for part in PARTS if part in skeleton.names)
        web = plugin("browser.web_format.write") if isinstance(avatar, Avatar) else None
        file = None if web is None else partial(web.web_file, avatar)
        stated = avatar.meta.get("title") if isinstance(avatar, Avatar) else None
        title = stated if isinstance(stated, str) and NAME.fullmatch(stated) else ""  # a file may contain anything
        info = AvatarInfo(name=name, title=title, skeleton=skeleton, parts=parts, file=file)
        if why := why_not_tracked(skeleton):
            return replace(info, untracked=why)
        from glsplat.net.backends.tracking import TrackingSolver  # loaded late: scenery and other rigs need none
        from glsplat.tracking.calibration import EYES_OF_STATURE, Calibration
        from glsplat.tracking.solve.body import Body

        base = self.calibration or Calibration(automatic=True)

        def solving(height: float | None, span: float | None) -> TrackingSolver:
            fitted = base if height is None else Calibration.of_height(skeleton, height, base.floor)
            fitted = fitted if span is None else fitted.with_span(skeleton, span)
            return TrackingSolver(skeleton, fitted, self.solver, self.idle, self.face)

        return replace(info, solver=solving, height=Body.of(skeleton).eye_height / EYES_OF_STATURE)


@dataclass(frozen=True, slots=True, kw_only=True)
class ServedScene:
    """A scene, other avatars that clients may choose by name, and the rooms in which they meet.

    Poses of clients apply to the scene's one visible avatar, which may be a rigged mesh. With several avatars a pose is
    refused, with none it has no effect. Motions of a scene file play on the server's clock. Raises GlsplatError for
    names that no client could request.
    """

    file: SceneFile
    name: str = "default"  # of the scene, among the avatars
    title: str = ""  # the name that people see; "": the title in its file
    avatars: Mapping[str, Rigged] = field(default_factory=dict)
    rooms: Mapping[str, SceneFile] = field(default_factory=dict)  # the scenery of each
    rendering: RenderConfig | None = None
    tracking: TrackingOptions = TrackingOptions()

    def __post_init__(self) -> None:
        for name, avatar in self.avatars.items():
            if name == self.name:
                raise GlsplatError(f'two avatars are called "{name}": clients choose by name, give one another')
            checked_avatar(name, avatar, self.rendering)

    @property
    def avatar(self) -> Rigged | None:
        """The scene's one avatar, which clients pose; None where there is none, or several."""
        item = self.file.avatar
        return item.content if item is not None and is_rigged(item.content) else None

    def offers(self) -> list[AvatarInfo]:
        """Return the avatars that clients may choose, the scene first."""
        first = _static(self.name, self.file) if self.avatar is None else self._describe(self.name, self.avatar)
        others = [self._describe(name, avatar) for name, avatar in self.avatars.items()]
        return [replace(first, title=self.title or first.title), *others]

    def configured(self, config: ServerConfig) -> ServerConfig:
        """Return ``config`` with the scene's light and the rooms; ``config`` may have seats of the rooms."""
        seats = {name: config.rooms.get(name, DEFAULT_SEATS) for name in self.rooms}
        furnished = frozenset(name for name, room in self.rooms.items() if room.scene.items)
        wire = replace(config.wire, light=self.file.scene.light)
        return replace(config, wire=wire, rooms=seats, furnished=furnished)

    def backend(self, size: tuple[int, int], **options: Any) -> Callable[[], RendererBackend]:
        """Return a factory of renderers of ``size`` pixels an eye; it can be pickled.

        ``options`` are those of RendererBackend: device, avatars, max_cost, max_time.
        """
        more = {"avatars": self.avatars, "rooms": dict(self.rooms), "config": self.rendering} | options
        return partial(RendererBackend, self.file, size, **more)

    def _describe(self, name: str, avatar: Rigged) -> AvatarInfo:
        return self.tracking.describe(name, avatar)


def gl_server(
    scene: SceneLike | SceneFile,
    config: ServerConfig | None = None,
    *,
    avatars: Mapping[str, Rigged] | None = None,
    rooms: Mapping[str, SceneLike | SceneFile] | None = None,
    rendering: RenderConfig | None = None,
    tracking: TrackingOptions | None = None,
    features: Sequence[Feature] = (),
    own_process: bool = True,
) -> Server:
    """Return a server that draws ``scene`` with OpenGL, in a process of its own or else in a thread.

    Clients see the scene, or one of ``avatars`` by the name in their address (/ws?avatar=NAME). Nothing is opened
    before ``await server.start()`` or ``await server.run()``::

        asyncio.run(gl_server(glsplat.load("me.glb"), ServerConfig(port=8000)).run())
    """
    served = ServedScene(
        file=_file_of(scene),
        avatars=avatars or {},
        rooms={name: _file_of(room) for name, room in (rooms or {}).items()},
        rendering=rendering,
        tracking=tracking or TrackingOptions(),
    )
    config = served.configured(config or ServerConfig())
    make = served.backend(config.wire.size)
    backend = process_worker(make, config.wire.max_side, MAX_PICTURE_S) if own_process else make()
    offers = served.offers()
    log_limits(offers)
    return server_of(backend, config, offers, features)


def server_of(
    backend: Backend | Worker | Drawer,
    config: ServerConfig | None = None,
    offered: Sequence[AvatarInfo] = (AvatarInfo(name="default"),),
    features: Sequence[Feature] = (),
    later: Callable[[], Iterable[AvatarInfo]] = tuple,
) -> Server:
    """Return a server that draws with ``backend``: on a thread of this process, with a worker, or with a pool.

    It has the standard features and ``features``. ``later`` returns more avatars to offer once clients can connect.
    """
    config = config or ServerConfig()
    drawer = ThreadWorker(backend) if isinstance(backend, Backend) else backend
    if isinstance(drawer, Worker):
        drawer = RenderLoop(drawer, clock, config.fps, PictureEncoder(config.video))
    return Server(Catalogue(offered, later), drawer, config, (*standard_features(config), *features))


def standard_features(config: ServerConfig) -> list[Feature]:
    """Return the pages, and the features of installed extras that ``config`` turns on.

    Raises GlsplatError where ``config`` needs an extra that is not installed.
    """
    found: list[Feature] = [Pages()]
    for extra, needed, what in (
        ("browser", False, "drawing in the browser"),
        ("operations", False, "the status page"),
        ("rooms", bool(config.rooms), "a room"),
        ("far_links", config.webtransport, "WebTransport"),
    ):
        module = plugin(f"{extra}.feature")
        if module is not None:
            found += module.features(config)
        elif needed:
            raise GlsplatError(missing(extra, what))
    return found


def checked_avatar(name: str, avatar: Rigged, rendering: RenderConfig | None) -> None:
    """Raise GlsplatError for a name that an address cannot hold, and for an avatar that cannot be drawn."""
    if not (isinstance(name, str) and 0 < len(name) <= _MAX_NAME_CHARS and name.isprintable() and name.strip() == name):
        raise GlsplatError(f"an avatar's name needs 1 to {_MAX_NAME_CHARS} printable characters, not {name!r:.80}")
    if not is_rigged(avatar):
        raise GlsplatError(f'"{name}": clients choose avatars, not {type(avatar).__name__} without joints to move')
    splats = avatar.splats if isinstance(avatar, Avatar) else None
    if rendering is not None and rendering.cull_hidden is True and splats is not None and splats.cones is None:
        raise GlsplatError(f'"{name}": cull_hidden needs visibility cones; make them (glsplat avatar cones)')


def log_limits(offers: Iterable[AvatarInfo]) -> None:
    """Log for each avatar why poses or tracking cannot be applied."""
    for one in offers:
        if one.still:
            log.warning('"%s": poses and tracking are not applied: %s; clients move the camera', one.name, one.still)
        elif one.untracked:
            what = "motions and tracking are" if one.skeleton is None or why_not_driven(one.skeleton) else "tracking is"
            how = "" if one.skeleton is None else ", and its joints by their names"
            log.warning('"%s": %s not applied: %s; clients move the camera%s', one.name, what, one.untracked, how)


def _static(name: str, file: SceneFile) -> AvatarInfo:
    """Return the entry of a scene that no client can pose: it has no avatar, or several."""
    if file.scene.figures:
        return AvatarInfo(name=name, untracked="the scene has several avatars, each does what the scene file says")
    why = why_not_driven(None)
    return AvatarInfo(name=name, untracked=why, still=why)


def _file_of(scene: SceneLike | SceneFile) -> SceneFile:
    return scene if isinstance(scene, SceneFile) else SceneFile.of(scene)

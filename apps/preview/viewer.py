"""Viewer: turns the preview's events into pictures in a framebuffer, without a window system."""

from __future__ import annotations

import sys
import time
from collections import deque
from pathlib import Path
from typing import TYPE_CHECKING, Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera
from glsplat.errors import GlsplatError
from glsplat.formats.scene_file import SceneFile
from glsplat.gl.context import Context
from glsplat.motion.motion import Motion
from glsplat.renderer.present import Layout, Present, view_size
from glsplat.scene import SceneLike
from glsplat.skinning.pose import Pose
from glsplat.views import viewing_point

from ..output import save_png
from .cameras import Options, View, cameras_of
from .files import Dropped, motion_names, read_dropped, read_motion, shown
from .overlay import Line, Overlay, number_lines, text_image
from .pictures import LocalPictures
from .player import Others, Player, Tracked, players_of

if TYPE_CHECKING:
    from .connect import StreamedPictures

_TURN_DEG = 5.0  # per key press
_ORBIT_RAD = 3.5  # per height of the window
_ZOOM = 0.9  # factor of the distance per notch of the wheel
_MAX_FLIGHT_S = 0.1  # per frame, so that the eye does not jump after a pause

_ACTIONS: dict[str, tuple[Any, ...]] = {
    "1": ("lay_out", "mono"),
    "2": ("lay_out", "side-by-side"),  # left eye on the left
    "3": ("lay_out", "anaglyph"),  # both eyes in one picture for red-cyan glasses
    "space": ("play",),
    ".": ("step", 1),
    ",": ("step", -1),
    "M": ("next_motion",),
    "[": ("select", -1),
    "]": ("select", 1),
    "backspace": ("straighten",),
    "R": ("reset_view",),
    "P": ("screenshot",),
    "O": ("toggle", "numbers"),
    "H": ("toggle", "help"),
    "escape": ("quit",),
}
"""Key -> method of Viewer and its arguments. Keys have the names of window.py."""

_FLIGHT: dict[str, tuple[float, float, float]] = {
    "W": (0, 0, 1),
    "S": (0, 0, -1),
    "A": (-1, 0, 0),
    "D": (1, 0, 0),
    "E": (0, 1, 0),
    "Q": (0, -1, 0),
}
"""Key -> direction (right, up, forward) of flight while it is held."""

_TURNS: dict[str, tuple[float, float, float]] = {
    "up": (-1, 0, 0),
    "down": (1, 0, 0),
    "left": (0, -1, 0),
    "right": (0, 1, 0),
    "page up": (0, 0, 1),
    "page down": (0, 0, -1),
}
"""Key -> axis about which the selected joint turns, in the joint's frame."""


class Viewer:
    """A scene, a view and a pose, changed by events; ``dirty`` while the picture is out of date."""

    def __init__(
        self,
        scene: SceneLike | SceneFile,  # for its skeleton and view; drawn unless ``pictures`` are given
        context: Context,
        size: tuple[int, int],
        options: Options,
        label: str = "",
        pictures: LocalPictures | StreamedPictures | None = None,  # released with the viewer
    ) -> None:
        self.options = options
        self.layout: Layout = options.layout
        self.size = size
        self.dirty = True
        self.closing = False
        self.player: Player | None = None
        self.view = self._home = View(np.zeros(3), 1.0)
        self._label, self.others = label, Others()
        self._context = context
        self.overlay = Overlay(options.numbers)
        self._held: set[str] = set()
        self.shift = False  # is held, for flight
        self._drag = ""
        self._cursor = (0.0, 0.0)
        self._text: tuple[Line, ...] = ()
        self._frames: deque[float] = deque(maxlen=30)
        self._present_ms = 0.0
        self._motion_index = -1
        self._exposed = True  # the window has to be redrawn even without a new picture
        self.pictures = pictures or LocalPictures(
            shown(scene), context, view_size(size, self.layout), options.rendering
        )
        try:
            self._present = Present(context.ctx)
            self._show(scene, label)
        except BaseException:
            self.pictures.release()
            raise

    # ---------------------------------------------------------------------------------------------------- state

    @property
    def animating(self) -> bool:
        """Whether the picture changes without events."""
        return bool(self._held) or self.others.moving or (self.player is not None and self.player.moving)

    @property
    def timeout(self) -> float | None:
        """Seconds until the still picture changes; None: wait for an event."""
        return self.overlay.left if self.overlay.left > 0 else None

    def cameras(self) -> list[Camera]:
        """Return the current cameras of the window."""
        o = self.options
        return cameras_of(self.view, self.layout, self.size, o.fov, o.ipd, o.background)

    def pose(self) -> Pose | None:
        """Return the current pose; None for a scene without a skeleton."""
        return None if self.player is None else self.player.pose()

    def advance(self, seconds: float) -> None:
        """Advance motion, flight and messages, and check for new pictures."""
        if not self.animating:
            self._frames.clear()  # a pause is not a slow picture
        notice, self.overlay.notice = self.overlay.notice, self.pictures.notice
        if self.overlay.advance(seconds) or notice != self.overlay.notice:
            self.dirty = self._exposed = True
        self.dirty |= self.pictures.fresh
        for clock in (self.player, self.others):
            if clock is not None and clock.moving:
                clock.advance(seconds)
                self.dirty = True
        if self._held:
            direction = np.sum([_FLIGHT[key] for key in self._held], axis=0)
            # proportional to the size of the scene, slower near the target
            speed = max(0.05 * self._home.distance, 0.6 * min(self.view.distance, self._home.distance))
            step = direction * speed * (3 if self.shift else 1) * min(seconds, _MAX_FLIGHT_S)
            self.view = self.view.moved(*map(float, step))
            self.dirty = True

    # --------------------------------------------------------------------------------------------------- events

    def press(self, key: str, shift: bool = False, repeated: bool = False) -> None:
        """Handle a pressed (or repeated) key; names as in window.py."""
        self.shift = shift
        if key in _FLIGHT:
            self._held.add(key)
        elif key in _TURNS and self.player is not None:
            self._turn(_TURNS[key], 1.0 if shift else _TURN_DEG)
        elif key in _ACTIONS and (not repeated or key in ".,[]"):
            action, *arguments = _ACTIONS[key]
            getattr(self, action)(*arguments)
        self._changed()

    def release_key(self, key: str) -> None:
        """Handle a released key."""
        self._held.discard(key)

    def drag(self, button: str, shift: bool = False) -> None:
        """Handle a pressed mouse button: left, middle, right, or \"\" if all are released."""
        self._drag = "middle" if button == "left" and shift else button

    def move(self, x: float, y: float) -> None:
        """Handle the cursor at (x, y), pixels from the upper left corner."""
        height = max(1, self.size[1])
        right, down = (x - self._cursor[0]) / height, (y - self._cursor[1]) / height
        self._cursor = (x, y)
        if not self._drag or (right, down) == (0, 0):
            return
        if self._drag == "left":
            self.view = self.view.orbited(-right * _ORBIT_RAD, down * _ORBIT_RAD)
        elif self._drag == "right":
            self.view = self.view.looked(right * _ORBIT_RAD / 2, -down * _ORBIT_RAD / 2)
        else:
            metres = 2 * self.view.distance * float(np.tan(np.radians(self.options.fov) / 2))
            self.view = self.view.moved(-right * metres, down * metres, 0)
        self.dirty = True

    def scroll(self, notches: float) -> None:
        """Handle the wheel: up zooms in."""
        home = self._home.distance
        self.view = self.view.zoomed(_ZOOM**notches, 1e-3 * home, 1e3 * home)
        self.dirty = True

    def unfocus(self) -> None:
        """Handle the loss of focus: no key is held."""
        self._held.clear()
        self._drag = ""

    def resize(self, width: int, height: int) -> None:
        """Handle a new size in pixels; 0 if iconified."""
        self.size = (width, height)
        self.dirty = self._exposed = True

    def expose(self) -> None:
        """Redraw the window, whose picture the window system lost."""
        self.dirty = self._exposed = True

    def drop(self, path: str) -> None:
        """Open a dropped scene, pose or motion; an error is shown in the window and changes nothing."""
        try:
            self.open(read_dropped(path, None if self.player is None else self.player.skeleton))
        except (GlsplatError, moderngl.Error) as error:
            print(f"glsplat preview: {error}", file=sys.stderr)
            self.overlay.say(str(error))
        self._changed()

    def open(self, what: Dropped) -> None:
        """Show the content of a file."""
        if not isinstance(what.content, (Motion, Pose)):
            self.pictures.load(shown(what.content))
            self._show(what.content, what.label)
        elif self.player is None:
            raise GlsplatError(f"{what.label}: this scene has no skeleton to move; drop an avatar first")
        elif isinstance(what.content, Motion):
            self.player.play(what.content)
        else:
            self.player.hold(what.content)
        self.overlay.say(what.label)

    # -------------------------------------------------------------------------------------------------- actions

    def lay_out(self, layout: Layout) -> None:
        """Show one view, or both eyes."""
        self.layout = layout

    def play(self) -> None:
        """Start or stop the clocks."""
        self.others.toggle()
        if self.player is not None:
            self.player.playing = not self.player.playing

    def step(self, frames: int) -> None:
        """Pause, and step by frames."""
        if self.player is not None:
            self.player.step(frames)

    def next_motion(self) -> None:
        """Play the next embedded motion; after the last show the zero pose."""
        names = motion_names(None if self.player is None else self.player.skeleton)
        if self.player is None or not names:
            return self.overlay.say("this scene has no skeleton that the embedded motions fit")
        self._motion_index = (self._motion_index + 1) % (len(names) + 1)
        if self._motion_index == len(names):
            self.player.hold(None)
            return self.overlay.say("zero pose")
        self.player.play(read_motion(names[self._motion_index], self.player.skeleton))
        self.overlay.say(names[self._motion_index])

    def select(self, step: int) -> None:
        """Select the next (1) or previous (-1) joint."""
        if self.player is None:
            return self.overlay.say("this scene has no joints")
        self.player.select(step)
        self.overlay.say(f"{self.player.joint_name}: turn it with the arrow keys")

    def straighten(self) -> None:
        """Undo the rotation of the selected joint by arrow keys."""
        if self.player is not None:
            self.player.straighten()

    def reset_view(self) -> None:
        """Return to the initial view."""
        self.view = self._home

    def screenshot(self) -> None:
        """Save the picture in the current folder, named by the time."""
        name = time.strftime("glsplat-%Y%m%d-%H%M%S")
        path = next(p for i in range(1000) if not (p := Path(f"{name}{f'-{i}' if i else ''}.png")).exists())
        try:
            save_png(path, self.capture())
        except GlsplatError as error:
            return self.overlay.say(str(error))
        self.overlay.say(f"saved {path}")

    def toggle(self, what: str) -> None:
        """Show or hide "numbers" (stage times and splat counts; every stage then waits for the GPU) or "help"."""
        setattr(self.overlay, what, not getattr(self.overlay, what))

    def quit(self) -> None:
        """Close the window."""
        self.closing = True

    # ------------------------------------------------------------------------------------------------- pictures

    def refresh(self, framebuffer: moderngl.Framebuffer) -> bool:
        """Redraw the window and clear ``dirty``; return False if there is nothing new to show."""
        self.dirty = False
        if min(self.size) < 1:
            return False
        new = self.pictures.request(self.cameras(), self.player)
        if not (new or self._exposed):
            return False
        if not self.animating:
            self.overlay.renew()  # this may be the last picture: show its own numbers
        self.draw(framebuffer, new=new)
        return True

    def wait_ready(self) -> None:
        """Wait for the current picture. Raises GlsplatError if it fails."""
        if min(self.size) > 0:
            self.pictures.request(self.cameras(), self.player)
            self.pictures.wait_ready()

    def draw(self, framebuffer: moderngl.Framebuffer, live: bool = True, new: bool = True) -> None:
        """Draw picture and text into ``framebuffer`` and clear ``dirty``. An iconified window is not drawn."""
        self.dirty = self._exposed = False
        if min(self.size) < 1:
            return
        exact = self.overlay.numbers
        target = self.pictures.draw(self.cameras(), self.player, exact)
        start = time.perf_counter()
        self._write_text(live)
        self._present.run(target, framebuffer, self.size, self.layout)
        if exact:
            self._context.ctx.finish()
        now = time.perf_counter()
        self._present_ms = (now - start) * 1e3
        if new:
            self._frames.append(now)

    def capture(self) -> NDArray[np.uint8]:
        """Return the window's pixels [H, W, 3] without messages, redrawn because a covered window has none."""
        if min(self.size) < 1:
            raise GlsplatError("the window is iconified; there is nothing to save")
        texture = self._context.ctx.texture(self.size, 4)
        framebuffer = self._context.ctx.framebuffer([texture])
        try:
            self.draw(framebuffer, live=False, new=False)
            data = framebuffer.read(components=3, alignment=1)
        finally:
            self._context.scratch.use()
            framebuffer.release()
            texture.release()
        self.dirty = self._exposed = True
        pixels = np.frombuffer(data, np.uint8).reshape(self.size[1], self.size[0], 3)
        return np.ascontiguousarray(pixels[::-1])

    def report(self) -> dict[str, Any]:
        """Return driver, counts and stage times of the last frame."""
        return {"window": list(self.size), "layout": self.layout, **self.pictures.report()}

    def release(self) -> None:
        """Delete all GL objects."""
        self._present.release()
        self.pictures.release()

    # ------------------------------------------------------------------------------------------------ internals

    def _show(self, scene: SceneLike | SceneFile, label: str) -> None:
        """Set up players and view of a loaded scene."""
        before, self._label = self.player, label
        self.player, self.others = players_of(scene if isinstance(scene, SceneFile) else SceneFile.of(scene))
        if self.player is not None and self.player.idle and before is not None and before.motion is not None:
            if before.motion.names == self.player.skeleton.names:
                self.player.play(before.motion)
                self.player.playing = before.playing
        eye, target = viewing_point(shown(scene), self.options.fov)
        if before is None:  # the options are for the first scene only
            eye = eye if self.options.eye is None else np.array(self.options.eye)
            target = target if self.options.target is None else np.array(self.options.target)
        self.view = self._home = View.between(eye, target)

    def _turn(self, axis: tuple[float, float, float], degrees: float) -> None:
        assert self.player is not None
        if isinstance(self.player.motion, Tracked):
            return self.overlay.say("the server solves this recording: no joint can be turned (M: next motion)")
        if self.player.joint is None:
            self.player.select(1)
        self.player.turn(axis, degrees)
        self.overlay.say(f"{self.player.joint_name}: turned {self.player.turned:.0f} degrees")

    def _changed(self) -> None:
        self.dirty = self._exposed = True
        self.overlay.renew()

    def _write_text(self, live: bool) -> None:
        lines = self.overlay.lines(self._number_lines, live)
        if lines != self._text:
            self._present.write_text(text_image(lines, self.options.text_scale))
            self._text = lines

    def _number_lines(self) -> list[Line]:
        rate = None
        if self.animating and len(self._frames) > 1:
            rate = (len(self._frames) - 1) / (self._frames[-1] - self._frames[0])
        stages = self.pictures.stages() | {"present": self._present_ms}
        width, height = view_size(self.size, self.layout)
        title = f"{self._label}  {self.layout} {'' if self.layout == 'mono' else '2 x '}{width}x{height}"
        return number_lines([(title,), *self.pictures.facts()], self.player, stages, rate)

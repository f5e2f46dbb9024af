"""Scene: several things in one frame, each an item with a place, a pose and a switch. Values: nothing here draws."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, TypeGuard

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glsplat.arrays import bits, count, flag, instance, listed, number, plain
from glsplat.avatar import Avatar
from glsplat.errors import GlsplatError, PoseError
from glsplat.meshes import RiggedMesh
from glsplat.rotations import quaternion_matrices
from glsplat.skinning.pose import Pose
from glsplat.skinning.skeleton import Skeleton
from glsplat.splats import Splats

if TYPE_CHECKING:
    from glsplat.light.light import Light

__all__ = ["Content", "Item", "Rigged", "Scene", "SceneLike", "is_rigged", "similarity", "skeleton_of"]

Content = Splats | Avatar | RiggedMesh
"""What an item may show."""

Rigged = Avatar | RiggedMesh
"""What a pose may move (``is_rigged``), in short an avatar: splats with a skin, or a mesh with joints."""

_LARGEST = 1e6  # metres, and of a scale; beyond it is a mistake of units
_SMALLEST = 1e-6


def is_rigged(thing: object) -> TypeGuard[Rigged]:
    """Whether a pose may move it: an Avatar, or a RiggedMesh of more than one joint; on one joint a mesh just stands.

    >>> glsplat.scene.is_rigged(glsplat.default_avatar()), glsplat.scene.is_rigged(glsplat.default_avatar().splats)
    (True, False)
    """
    return isinstance(thing, Avatar) or (isinstance(thing, RiggedMesh) and len(thing.skeleton) > 1)


def skeleton_of(thing: Content) -> Skeleton | None:
    """What a pose moves of it; None of what only stands (``is_rigged``)."""
    return thing.skeleton if is_rigged(thing) else None


class Item:
    """Splats, an Avatar or a RiggedMesh in a scene. What it shows is fixed; the rest may change between frames.

    ``transform`` [4, 4] takes the thing's own space to the scene: a rotation, one scale for all axes, a translation
    in metres (see ``similarity``). Assigning an attribute checks and copies what it is given.

    >>> item = glsplat.Item(glsplat.default_avatar(), name="Ann")
    >>> item.transform = glsplat.similarity((0, 0, 2), scale=1.1)
    >>> item
    Item(Avatar 'Ann' at (0, 0, 2))
    """

    __slots__ = ("_content", "_finest", "_layers", "_name", "_opacity", "_pose", "_transform", "_visible")

    def __init__(
        self,
        content: Content,
        *,
        pose: Pose | None = None,  # zero pose if none
        transform: ArrayLike | None = None,  # [4, 4]
        visible: bool = True,
        opacity: float = 1.0,
        name: str = "",
        layers: int = 1,
        finest: int = 0,
    ) -> None:
        if not isinstance(content, (Splats, Avatar, RiggedMesh)):
            raise GlsplatError(f"an item shows Splats, an Avatar or a RiggedMesh, not {type(content).__name__}")
        self._content = content
        self.pose = pose
        self._transform = _checked(np.eye(4) if transform is None else transform)
        self.visible = visible
        self.opacity = opacity
        self.layers = layers
        self.finest = finest
        self._name: str = instance(name, str, "an item's name", GlsplatError)

    @property
    def content(self) -> Content:
        """What it shows."""
        return self._content

    @property
    def name(self) -> str:
        """For people; need not be distinct."""
        return self._name

    @property
    def pose(self) -> Pose | None:
        """Of its skeleton; None: the zero pose."""
        return self._pose

    @pose.setter
    def pose(self, pose: Pose | None) -> None:
        if pose is not None:
            if not isinstance(pose, Pose):
                raise PoseError(f"an item's pose is a Pose, not {type(pose).__name__}; see Pose.from_smplx")
            if isinstance(self._content, Splats):
                raise PoseError("splats without a skeleton have no pose; move them with transform")
            joints = len(self._content.skeleton)
            if len(pose.rotations) != joints:
                raise PoseError(f"the pose has {len(pose.rotations)} joints, the item {joints}")
        self._pose = pose

    @property
    def transform(self) -> NDArray[np.float64]:
        """[4, 4] scene from item; read only, assign a new one to move it."""
        return self._transform

    @transform.setter
    def transform(self, transform: ArrayLike) -> None:
        self._transform = _checked(transform)

    @property
    def visible(self) -> bool:
        """False: it costs nothing and keeps its buffers."""
        return self._visible

    @visible.setter
    def visible(self, visible: bool) -> None:
        self._visible = flag(visible, "an item's visible", GlsplatError)

    @property
    def layers(self) -> int:
        """Bits: a view draws it if ``layers & camera.layers`` is not 0. Nothing is staged anew for another view."""
        return self._layers

    @layers.setter
    def layers(self, layers: int) -> None:
        self._layers = bits(layers, "an item's layers", GlsplatError)

    @property
    def finest(self) -> int:
        """Level of detail that is the finest drawn of it, however near it is; 0: all. The coarsest if it has fewer."""
        return self._finest

    @finest.setter
    def finest(self, finest: int) -> None:
        self._finest = count(finest, "an item's finest level", GlsplatError, 0)

    @property
    def opacity(self) -> float:
        """0 to 1, by which the opacity of each of its splats is multiplied. A mesh is opaque, whatever it says."""
        return self._opacity

    @opacity.setter
    def opacity(self, opacity: float) -> None:
        value = number(opacity, "an item's opacity", GlsplatError)
        if not 0 <= value <= 1:
            raise GlsplatError(f"an item's opacity needs 0 to 1, not {value:g}")
        self._opacity = value

    def __repr__(self) -> str:
        place = ", ".join(f"{v:g}" for v in self._transform[:3, 3])
        return f"Item({type(self._content).__name__} {self._name!r} at ({place}){'' if self._visible else ', hidden'})"


class Scene:
    """Items in one frame. Of splats at equal depth those of the earlier item are the nearer (docs/conventions.md).

    >>> person = glsplat.default_avatar()
    >>> scene = glsplat.Scene([glsplat.Item(person), glsplat.Item(person, transform=glsplat.similarity((0.7, 0, 0)))])
    >>> with glsplat.Renderer(scene, size=(64, 48)) as renderer:
    ...     camera = glsplat.Camera(glsplat.look_at((0, 1, 3), (0, 1, 0)), glsplat.pinhole(64, 48), 64, 48)
    ...     image, depth = renderer.render([camera], depth=True)
    >>> image.shape, depth.shape
    ((1, 48, 64, 4), (1, 48, 64))
    """

    def __init__(
        self,
        items: Iterable[Item] = (),
        *,
        light: Light | None = None,
        transform: ArrayLike | None = None,  # [4, 4]
    ) -> None:
        if isinstance(items, (Splats, Avatar, RiggedMesh, Item, str)) or not isinstance(items, Iterable):
            raise GlsplatError(f"a scene needs a list of Items, not {type(items).__name__}; write Scene([Item(...)])")
        self._items: list[Item] = []
        self.light = light
        self._transform = _checked(np.eye(4) if transform is None else transform)
        for item in listed(items, "a scene", GlsplatError):
            self.add(item)

    @classmethod
    def of(cls, thing: SceneLike) -> Scene:
        """The scene itself, or a scene of that one thing."""
        if isinstance(thing, Scene):
            return thing
        return cls([thing if isinstance(thing, Item) else Item(thing)])

    @property
    def light(self) -> Light | None:
        """What falls on all that knows its surface (``Splats.surface``); None: colours are shown as they are.

        Meshes and splats without a surface are not lit.
        """
        return self._light

    @light.setter
    def light(self, light: Light | None) -> None:
        if light is not None:
            from glsplat.light.light import Light  # here: clients and most scenes have none

            instance(light, Light, "a scene's light", GlsplatError)
        self._light: Light | None = light

    @property
    def transform(self) -> NDArray[np.float64]:
        """[4, 4] the cameras' world from the scene, applied after each item's own; read only, assign a new one."""
        return self._transform

    @transform.setter
    def transform(self, transform: ArrayLike) -> None:
        self._transform = _checked(transform)

    @property
    def items(self) -> tuple[Item, ...]:
        """In the order in which they were added."""
        return tuple(self._items)

    @property
    def figures(self) -> tuple[Item, ...]:
        """The visible items that a pose may move."""
        return tuple(item for item in self._items if item.visible and is_rigged(item.content))

    def add(self, item: Item) -> Item:
        """Put an item behind the others; returns it."""
        if not isinstance(item, Item):
            raise GlsplatError(f"a scene holds Items, not {type(item).__name__}; write Item(...)")
        if any(item is other for other in self._items):
            raise GlsplatError(f"{item} is in the scene already; make another Item of the same content")
        self._items.append(item)
        return item

    def remove(self, item: Item) -> None:
        """Take an item out; its buffers are released with the next frame."""
        try:
            if isinstance(item, Item):  # which equals nothing but itself
                return self._items.remove(item)  # in one step: other threads may take out others
        except ValueError:
            pass
        raise GlsplatError(f"{item!r:.60} is not in the scene")

    def __len__(self) -> int:
        return len(self._items)

    def __iter__(self) -> Iterator[Item]:
        return iter(self.items)

    def __repr__(self) -> str:
        return f"Scene({len(self._items)} items)"


SceneLike = Scene | Item | Content
"""What a renderer takes: a scene, or one thing, which is then a scene of one."""


def similarity(
    translation: ArrayLike = (0.0, 0.0, 0.0),  # [3] metres
    rotation: ArrayLike = (0.0, 0.0, 0.0, 1.0),  # [4] quaternion xyzw of any length but zero
    scale: float = 1.0,
) -> NDArray[np.float64]:
    """[4, 4] of x -> scale * R x + translation. Raises GlsplatError for what is no such transform.

    >>> (glsplat.similarity((0, 1, 0), scale=2) @ (1, 0, 0, 1)).tolist()
    [2.0, 1.0, 0.0, 1.0]
    """
    quat = plain(rotation, "a rotation xyzw", GlsplatError).astype(np.float64)
    offset = plain(translation, "a translation", GlsplatError).astype(np.float64)
    size = number(scale, "a scale", GlsplatError)
    if quat.shape != (4,) or offset.shape != (3,):
        raise GlsplatError(f"a transform needs translation [3] and rotation xyzw [4], not {offset.shape}, {quat.shape}")
    if not np.isfinite(offset).all():
        raise GlsplatError(f"a translation needs finite numbers, not {offset.tolist()}")
    norm = np.linalg.norm(quat) if np.abs(quat).max() < 1e100 else np.inf
    if not 1e-9 < norm < np.inf:
        raise GlsplatError(f"a rotation needs a finite quaternion xyzw of non-zero length, not {quat.tolist()}")
    out = np.eye(4)
    out[:3, :3] = size * quaternion_matrices(np.roll(quat / norm, 1))
    out[:3, 3] = offset
    return _checked(out)


def _checked(transform: ArrayLike) -> NDArray[np.float64]:
    matrix = np.array(plain(transform, "a transform (a 4x4 matrix of numbers)", GlsplatError), np.float64)
    if matrix.shape != (4, 4):
        raise GlsplatError(f"a transform is a 4x4 matrix, not {matrix.shape}; see glsplat.scene.similarity")
    if not np.isfinite(matrix).all():
        raise GlsplatError("a transform needs finite numbers, found NaN or infinity")
    if np.abs(matrix[3] - (0, 0, 0, 1)).max() > 1e-9:
        raise GlsplatError("a transform needs the last row 0 0 0 1")
    if np.abs(matrix).max() > _LARGEST:
        raise GlsplatError(f"a transform needs metres and a scale below {_LARGEST:g}, not {np.abs(matrix).max():g}")
    linear = matrix[:3, :3]
    size = float(np.cbrt(np.linalg.det(linear)))
    if not size >= _SMALLEST:
        raise GlsplatError("a transform needs a rotation times a scale above 1e-6, no reflection")
    if np.abs(linear @ linear.T / size**2 - np.eye(3)).max() > 1e-4:
        raise GlsplatError("a transform needs one scale for all axes and no shear")
    matrix.setflags(write=False)
    return matrix

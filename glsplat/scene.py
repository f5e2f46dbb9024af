"""Scene: the items of a frame, each with a transform, a pose and a visibility. This module does not draw."""

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
"""Content of an item."""

Rigged = Avatar | RiggedMesh
"""Content with a skeleton (``is_rigged``): splats with a skin, or a mesh with joints."""

_MAX_VALUE = 1e6  # metres, or a scale; a larger value has the wrong unit
_MIN_SCALE = 1e-6


def is_rigged(thing: object) -> TypeGuard[Rigged]:
    """Return whether a pose can move ``thing``: an Avatar, or a RiggedMesh of more than one joint.

    >>> glsplat.scene.is_rigged(glsplat.default_avatar()), glsplat.scene.is_rigged(glsplat.default_avatar().splats)
    (True, False)
    """
    return isinstance(thing, Avatar) or (isinstance(thing, RiggedMesh) and len(thing.skeleton) > 1)


def skeleton_of(thing: Content) -> Skeleton | None:
    """Return the skeleton of rigged content; None for other content (``is_rigged``)."""
    return thing.skeleton if is_rigged(thing) else None


class Item:
    """Splats, an Avatar or a RiggedMesh in a scene. The content is fixed; the rest may change between frames.

    ``transform`` [4, 4] maps the content's space to the scene: a rotation, one scale for all axes, a translation in
    metres (see ``similarity``). Assigning an attribute validates and copies the value.

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
        pose: Pose | None = None,  # None: zero pose
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
        """Splats, Avatar or RiggedMesh."""
        return self._content

    @property
    def name(self) -> str:
        """Name for messages; need not be unique."""
        return self._name

    @property
    def pose(self) -> Pose | None:
        """Pose of the skeleton; None: the zero pose."""
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
        """Scene from item [4, 4]; read-only: assign a new one to move the item."""
        return self._transform

    @transform.setter
    def transform(self, transform: ArrayLike) -> None:
        self._transform = _checked(transform)

    @property
    def visible(self) -> bool:
        """Whether the item is drawn. A hidden item costs no time and keeps its buffers."""
        return self._visible

    @visible.setter
    def visible(self, visible: bool) -> None:
        self._visible = flag(visible, "an item's visible", GlsplatError)

    @property
    def layers(self) -> int:
        """Bit mask: a view draws the item if ``layers & camera.layers`` is not 0. Changing it uploads nothing."""
        return self._layers

    @layers.setter
    def layers(self, layers: int) -> None:
        self._layers = bits(layers, "an item's layers", GlsplatError)

    @property
    def finest(self) -> int:
        """Finest level of detail that is drawn at any distance; 0: no limit. The coarsest if there are fewer levels."""
        return self._finest

    @finest.setter
    def finest(self, finest: int) -> None:
        self._finest = count(finest, "an item's finest level", GlsplatError, 0)

    @property
    def opacity(self) -> float:
        """Factor, 0 to 1, of the splats' opacities; a mesh is always opaque."""
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
    """Items of one frame. At equal depth, splats of earlier items are nearer (docs/conventions.md).

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
        """Return ``thing`` if it is a scene, else a scene that holds it."""
        if isinstance(thing, Scene):
            return thing
        return cls([thing if isinstance(thing, Item) else Item(thing)])

    @property
    def light(self) -> Light | None:
        """Light on splats with a surface (``Splats.surface``); meshes and other splats keep their colours."""
        return self._light

    @light.setter
    def light(self, light: Light | None) -> None:
        if light is not None:
            from glsplat.light.light import Light  # here: most scenes have no light

            instance(light, Light, "a scene's light", GlsplatError)
        self._light: Light | None = light

    @property
    def transform(self) -> NDArray[np.float64]:
        """World from scene [4, 4], applied after each item's own transform; read-only: assign a new one.

        The renderer moves the cameras by it and not the items, so that nothing is skinned again.
        """
        return self._transform

    @transform.setter
    def transform(self, transform: ArrayLike) -> None:
        self._transform = _checked(transform)

    @property
    def items(self) -> tuple[Item, ...]:
        """Items in the order of their addition."""
        return tuple(self._items)

    @property
    def figures(self) -> tuple[Item, ...]:
        """Visible items with a skeleton."""
        return tuple(item for item in self._items if item.visible and is_rigged(item.content))

    def add(self, item: Item) -> Item:
        """Append an item and return it."""
        if not isinstance(item, Item):
            raise GlsplatError(f"a scene holds Items, not {type(item).__name__}; write Item(...)")
        if any(item is other for other in self._items):
            raise GlsplatError(f"{item} is in the scene already; make another Item of the same content")
        self._items.append(item)
        return item

    def remove(self, item: Item) -> None:
        """Remove an item; the next frame releases its buffers."""
        try:
            if isinstance(item, Item):  # an Item equals only itself
                return self._items.remove(item)  # atomic: other threads may remove other items
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
"""Argument of a renderer: a scene, or a single item or content."""


def similarity(
    translation: ArrayLike = (0.0, 0.0, 0.0),  # [3] metres
    rotation: ArrayLike = (0.0, 0.0, 0.0, 1.0),  # [4] quaternion xyzw of any length but zero
    scale: float = 1.0,
) -> NDArray[np.float64]:
    """Return the transform [4, 4] x -> scale * R x + translation. Raises GlsplatError for invalid arguments.

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
    if np.abs(matrix).max() > _MAX_VALUE:
        raise GlsplatError(f"a transform needs metres and a scale below {_MAX_VALUE:g}, not {np.abs(matrix).max():g}")
    linear = matrix[:3, :3]
    size = float(np.cbrt(np.linalg.det(linear)))
    if not size >= _MIN_SCALE:
        raise GlsplatError("a transform needs a rotation times a scale above 1e-6, no reflection")
    if np.abs(linear @ linear.T / size**2 - np.eye(3)).max() > 1e-4:
        raise GlsplatError("a transform needs one scale for all axes and no shear")
    matrix.setflags(write=False)
    return matrix

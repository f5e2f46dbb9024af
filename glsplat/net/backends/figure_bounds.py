"""FigureBounds: the box of an avatar in a pose, without posing its splats."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from glsplat.avatar import Avatar
from glsplat.net.backends.extent import Extent
from glsplat.scene import Rigged
from glsplat.skinning.pose import Pose
from glsplat.skinning.skin import Skin

__all__ = ["FigureBounds"]


class FigureBounds:
    """The boxes of one figure: measured when the first is asked for. Splats count with ``sigmas`` of their size.

    ``whole``: the box holds all of it in any pose, else nearly all, and fits more tightly (``Extent``).
    """

    def __init__(self, figure: Rigged, sigmas: float, whole: bool = False) -> None:
        self.figure: Rigged = figure
        self._sigmas, self._whole = sigmas, whole
        self._state: tuple[object, ...] = ()
        self._box: NDArray[np.float64] | None = None

    def box(self, pose: Pose | None, transform: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """Return the lowest and highest corner [2, 3] in the scene; None where nothing of it is drawn.

        ``pose`` None is the zero pose; ``transform`` [4, 4] takes the figure's space to the scene's.
        """
        posed = Pose.zero(len(self.figure.skeleton)) if pose is None else pose
        moved = b"" if posed.translations is None else posed.translations.tobytes()
        shape = tuple(posed.expression.items())
        state = posed.rotations.tobytes(), posed.trans.tobytes(), moved, shape, transform.tobytes()
        if state != self._state:  # else somebody else looks at them as they are
            self._state, self._box = state, self._measured(posed, transform)
        return self._box

    def _measured(self, pose: Pose, transform: NDArray[np.float64]) -> NDArray[np.float64] | None:
        figure = self.figure
        bones = transform[:3, :3] @ pose.bones(figure.skeleton)
        bones[:, :, 3] += transform[:3, 3]
        box, grown = self._extent.box(bones), self._grown(pose)
        if box is None or not grown:
            return box
        size = float(np.cbrt(np.linalg.det(transform[:3, :3])))
        return np.asarray(box + size * grown * np.array([[-1.0], [1.0]]))

    def _grown(self, pose: Pose) -> float:
        """Metres by which nothing moves farther with the pose's expression."""
        figure = self.figure
        if not isinstance(figure, Avatar):
            return 0.0 if figure.morphs is None else figure.morphs.farthest(pose)
        weights = figure.weights(pose)
        return 0.0 if weights is None or figure.shapes is None else figure.shapes.farthest(weights)

    @cached_property
    def _extent(self) -> Extent:
        figure, whole = self.figure, self._whole
        if isinstance(figure, Avatar):
            return Extent.of(figure.splats, figure.skin, self._sigmas, whole)
        used = np.unique(figure.faces)
        skin = Skin.create(figure.joints[used], figure.weights[used], len(figure.skeleton), influences=8)
        return Extent.of_points(figure.vertices[used], skin, whole)

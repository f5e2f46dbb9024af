"""Check the requirements of a comparison: packages, and files of networks."""

from __future__ import annotations

from collections.abc import Sequence

from glsplat.errors import GlsplatError
from glsplat.extras.authoring.models.catalogue import PHOTO
from glsplat.extras.authoring.models.store import state_of
from glsplat.extras.evaluate.comparison.protocol import Protocol
from glsplat.extras.evaluate.lpips import Lpips
from glsplat.optional import require_package

_SEEING = ("photo", "mesh-image", "mesh-video")  # methods that detect a person in pictures


def check_ready(methods: Sequence[str], protocol: Protocol) -> None:
    """Raise GlsplatError with the command that installs a missing network or package, before the first avatar."""
    if any(method in _SEEING for method in methods) and any(state_of(model) != "here" for model in PHOTO.models):
        raise GlsplatError(f"the networks that read photographs are not on this machine; run: {PHOTO.command}")
    Lpips("alex")
    if "lpips-vgg" in protocol.extra_measures:
        Lpips("vgg")
    require_package("the plots", "matplotlib", "evaluate")
    if "flip" in protocol.extra_measures:
        require_package("FLIP", "flip_evaluator", "evaluate")

"""Avatars that browsers draw by themselves, as a feature of a server (docs/webgl.md)."""

from __future__ import annotations

from glsplat.extras.browser.poses.splat_files import SplatFiles
from glsplat.net.feature import Feature
from glsplat.net.options import ServerConfig


def features(config: ServerConfig) -> list[Feature]:
    """Return the features of this extra, for every server."""
    return [SplatFiles()]

"""Rooms: people in one scene, each of whom sees the others through their own eyes (docs/deploying.md).

`rooms.Rooms` is a `Feature` of the server; `glsplat serve --room NAME:SEATS` adds it by `feature.features`.
"""

REQUIRES = ()

"""Avatars made from clients' photographs: an HTTP interface, a job queue and a folder (docs/protocol.md, section 9).

`routes.Uploads` is a `Feature` of the server; `glsplat serve --allow-upload FOLDER` adds it.
"""

REQUIRES = ()

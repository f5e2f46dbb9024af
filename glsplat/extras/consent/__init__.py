"""Signed consent in avatar files: the person shown, the purpose, the dates and the permitted drivers (docs/consent.md).

`policy.ConsentPolicy` plugs into the server by `ServerConfig.consent`; `glsplat avatar consent` signs files.
"""

REQUIRES = ()

"""Pages for the operator of a server: status, metrics, previews, curves, QR codes, self-signed certificates.

`feature.features` returns the `Feature`s, which every `glsplat serve` has (docs/deploying.md).
"""

REQUIRES = ()

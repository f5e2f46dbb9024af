"""Compare glsplat with other programs, by hand."""

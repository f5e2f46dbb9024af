"""Parts of ``glsplat selftest``: every path against float64, contexts, memory, speed."""

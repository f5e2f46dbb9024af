"""``glsplat selftest``: prove this driver, and measure it."""

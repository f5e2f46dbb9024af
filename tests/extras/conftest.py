"""Fixtures of servers, for the extras that plug into one."""

from __future__ import annotations

from tests.net.conftest import ahead, cameras, fake_backend, serve, stopped

__all__ = ["ahead", "cameras", "fake_backend", "serve", "stopped"]

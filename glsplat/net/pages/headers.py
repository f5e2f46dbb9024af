"""Headers that every answer has, and those it has unless it says otherwise."""

from __future__ import annotations

from aiohttp import web

__all__ = ["set_headers"]

_ALWAYS = {"X-Content-Type-Options": "nosniff", "Server": "glsplat"}
_BY_DEFAULT = {
    "Content-Security-Policy": "default-src 'none'; style-src 'unsafe-inline'",
    "Cache-Control": "no-store",
    "Cross-Origin-Resource-Policy": "same-origin",  # no other site's page shows or measures what is answered
}


async def set_headers(request: web.Request, response: web.StreamResponse) -> None:
    """For aiohttp's ``on_response_prepare``."""
    response.headers.update(_ALWAYS)
    for name, value in _BY_DEFAULT.items():
        response.headers.setdefault(name, value)

"""Pictures by datagrams (WebTransport) beside the WebSocket: ``serve --webtransport``."""

"""Pictures by datagrams (WebTransport) beside the WebSocket: serve's option webtransport."""

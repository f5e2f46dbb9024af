"""Pictures by datagrams (WebTransport) beside the WebSocket; imported only where ``serve --webtransport`` asks for it."""

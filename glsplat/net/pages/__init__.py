"""The server's pages over plain HTTP: the page for headsets, /healthz, /stats and /session."""

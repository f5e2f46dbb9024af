"""Programs for developers, which make embedded data, pictures and figures of the docs; none is installed."""

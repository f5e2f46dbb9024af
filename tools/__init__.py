"""Programs for the project's own people: what made embedded data and the pictures of the docs; none is installed."""

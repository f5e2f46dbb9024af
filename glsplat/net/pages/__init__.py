"""What the server says over plain HTTP: the page for headsets, the status page, numbers, what it offers."""

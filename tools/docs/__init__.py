"""What draws and measures what the docs show."""

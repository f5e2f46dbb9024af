"""What made embedded data."""

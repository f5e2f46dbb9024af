"""What an avatar gets last: levels of detail, and the cones from which its splats are visible."""

"""Making avatars: from meshes, scans and other makers' files, offline; nothing here runs with a frame."""

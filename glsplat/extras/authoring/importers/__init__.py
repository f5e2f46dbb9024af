"""Avatars from other programs' files: dumps of LHM and LAM, scans, splats bound to a mesh, other rigs."""

"""Files: opened, replaced and locked safely. Nothing of splats."""

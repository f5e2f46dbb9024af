"""Files as such: opened, replaced and locked safely, archives of arrays, PNG without surprises. Nothing of splats."""

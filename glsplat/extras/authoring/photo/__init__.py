"""Picture files: what is read of them, and how."""

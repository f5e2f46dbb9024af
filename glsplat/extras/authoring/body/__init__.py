"""The embedded body that all people are fitted with: its mesh, its face, the lining of its mouth, its segments."""

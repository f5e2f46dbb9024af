"""The embedded body that all people are fitted with: mesh, face, teeth, lining of the mouth, and segments."""

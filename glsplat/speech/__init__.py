"""Speech: sound to the weights of a speaking mouth, the same in Python and in the page (docs/speech.md)."""

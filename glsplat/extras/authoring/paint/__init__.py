"""The colours of a fitted body: seen in pictures, and guessed where no picture looks."""

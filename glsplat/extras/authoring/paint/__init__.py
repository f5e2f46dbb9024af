"""Colours of a fitted body: visible in pictures, and guessed where no picture looks."""

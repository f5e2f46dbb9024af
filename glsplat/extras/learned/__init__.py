"""A small recurrent network that guesses what head and hands only hint at; numpy alone."""

REQUIRES = ("formats",)

"""A small recurrent network that estimates the body from head and hands; numpy alone."""

REQUIRES = ("formats",)

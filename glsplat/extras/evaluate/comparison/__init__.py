"""Methods of making avatars, compared over participants under one control: the tables of the paper."""

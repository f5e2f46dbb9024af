"""Other programs, held against ours by hand."""

"""The runtime of this PC by pyopenxr (the extra ``openxr``), which is imported when a session begins."""

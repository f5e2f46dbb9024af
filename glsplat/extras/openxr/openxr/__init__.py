"""The runtime of this computer by pyopenxr (the extra ``openxr``), which is imported when a session begins."""

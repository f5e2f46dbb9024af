"""Everything beside the core, one folder a feature; the core never imports from here."""

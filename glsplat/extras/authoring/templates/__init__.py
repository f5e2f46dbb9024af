"""Replace what a photograph does not show by templates, which are deformed and coloured as the photograph shows."""

"""What mkdocs.yml needs to make a site of docs/: pages of the root and of the API, docstrings as Markdown."""

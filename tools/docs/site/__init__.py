"""Extensions for mkdocs.yml: pages of the root and of the API, docstrings as Markdown."""

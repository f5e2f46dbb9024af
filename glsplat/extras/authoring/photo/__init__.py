"""From pictures of a person towards an avatar: the picture files, the person's mask, the check of a capture."""

from glsplat.optional import require_package

require_package("reading photographs", "PIL", "authoring")

"""Picture files: what is read of them, and how."""

from glsplat.optional import require_package

require_package("reading photographs", "PIL", "authoring")

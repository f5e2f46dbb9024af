"""Read photographs from picture files."""

from glsplat.optional import require_package

require_package("reading photographs", "PIL", "authoring")

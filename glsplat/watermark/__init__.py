"""An invisible mark in the rendered avatar that leads from a leaked clip to the session that was served it."""

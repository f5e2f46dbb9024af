"""Moving faces: eyeballs, lids, lashes, hair, teeth and the mouth."""

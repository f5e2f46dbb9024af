"""Trained networks that find a person, hands, a face and eyes in a picture; nothing here downloads by itself."""

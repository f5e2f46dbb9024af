"""Colours of unseen surface: cloth continued around the body, and hair behind the head."""

"""Colours of surface that no picture shows: cloth that goes on around the body, and hair behind it."""

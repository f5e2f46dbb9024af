"""Sections of the report: what a setting costs and how far its picture is from the truth."""

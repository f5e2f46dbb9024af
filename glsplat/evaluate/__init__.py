"""Measuring: truth, differences, scores and timing series. Nothing at run time imports it."""

"""The statistics of a user study: aligned rank transform, F tests, contrasts, effect sizes, reliability, power."""

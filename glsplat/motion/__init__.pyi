from .motion import Motion as Motion

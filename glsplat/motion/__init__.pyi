from .loading import embedded_motions as embedded_motions
from .loading import load_motion as load_motion
from .motion import Motion as Motion

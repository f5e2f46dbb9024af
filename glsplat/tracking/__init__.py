"""Head and hand tracking to a full-body pose: filter, calibrate, inverse kinematics. Plain numbers and numpy only."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

from .light import Light as Light
from .surface import Surface as Surface

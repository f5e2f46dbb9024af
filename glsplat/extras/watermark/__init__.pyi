from . import detect as detect
from .mark import Watermark as Watermark

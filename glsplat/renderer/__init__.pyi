from .renderer import Prepared as Prepared
from .renderer import Renderer as Renderer
from .stats import FrameStats as FrameStats

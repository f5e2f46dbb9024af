from .avatar import Avatar as Avatar
from .camera import Camera as Camera
from .camera import look_at as look_at
from .camera import pinhole as pinhole
from .camera import stereo_cameras as stereo_cameras
from .config import RenderConfig as RenderConfig
from .data import default_avatar as default_avatar
from .errors import GlsplatError as GlsplatError
from .formats.registry import load as load
from .formats.registry import save as save
from .gl.context import create_context as create_context
from .meshes import RiggedMesh as RiggedMesh
from .pictures import straight as straight
from .renderer import Renderer as Renderer
from .scene import Item as Item
from .scene import Scene as Scene
from .scene import similarity as similarity
from .skinning.pose import Pose as Pose
from .skinning.shapes import Shapes as Shapes
from .skinning.skeleton import Skeleton as Skeleton
from .skinning.skin import Skin as Skin
from .splats import Splats as Splats

__version__: str

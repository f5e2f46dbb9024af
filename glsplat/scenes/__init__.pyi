from .camera_file import camera_from_json as camera_from_json
from .camera_file import load_cameras as load_cameras
from .camera_file import read_cameras as read_cameras
from .scene_file import SceneFile as SceneFile
from .scene_file import load_scene as load_scene

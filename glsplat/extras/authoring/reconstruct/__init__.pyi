from .photos import check_photos as check_photos
from .photos import from_photos as from_photos
from .photos import mesh_from_photos as mesh_from_photos
from .photos import reconstruct as reconstruct
from .reconstructor import Options as Options
from .video import from_video as from_video

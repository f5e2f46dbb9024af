from .sound import Sound as Sound
from .sound import read_wav as read_wav
from .speaking import Speaking as Speaking

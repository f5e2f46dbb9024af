from .avatar_score import SCORE_POSES as SCORE_POSES
from .avatar_score import score as score

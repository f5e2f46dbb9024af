from .smplx import JOINT_NAMES as JOINT_NAMES

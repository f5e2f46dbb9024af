from .details import fit_details as fit_details
from .eyes import read_eyes as read_eyes

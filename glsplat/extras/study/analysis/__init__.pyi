from .analysis import analyse as analyse
from .table import read_table as read_table

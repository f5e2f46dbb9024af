from ..flow import ReceivedReply as ReceivedReply
from .client import Client as Client
from .request import request_message as request_message

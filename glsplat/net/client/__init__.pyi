from .client import Client as Client
from .client import ReceivedReply as ReceivedReply
from .client import request_message as request_message
